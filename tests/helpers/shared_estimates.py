"""Estimates of frames, and tasks of calibrations and recordings, made once for the same inputs and then shared.

For tests whose subject is what is done with results: an estimate takes some 0.4 s of processor time.
"""

from __future__ import annotations

import hashlib
import io
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any

import pytest

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs import frame as frames
from dvrk_cmaes.runs import instrument_processes
from dvrk_cmaes.runs.digests import instrument_digest
from dvrk_cmaes.silhouette import Body

_KNOWN: dict[str, Result] = {}
_ANSWERS: dict[str, bytes] = {}
"""Pickled, as those of a worker, so that no test can change what another one is given."""


def _digest(given: object) -> str:
    """Compute a digest of what is given, which is the same for equal values, whether or not parts are one object."""
    pickled = io.BytesIO()
    pickler = pickle.Pickler(pickled)
    pickler.fast = True  # parts that occur again are written again
    pickler.dump(given)
    return hashlib.sha256(pickled.getbuffer()).hexdigest()


@contextmanager
def shared_estimates() -> Iterator[None]:
    """Let frames that were estimated in this process with the same inputs and settings have the same result again.

    So do the tasks of frames that are solved together, of which calibrations and recordings are made.
    """
    estimate_views, call = frames.estimate_views, instrument_processes._call

    def estimated(views: Any, readings: Any, body: Body, **options: Any) -> Result:
        key = instrument_digest(body.instrument) + _digest(
            (views, dict(readings), body.method, sorted(options.items()))
        )
        if key not in _KNOWN:
            _KNOWN[key] = estimate_views(views, readings, body, **options)
        return _KNOWN[key]

    @wraps(call)  # under its name, by which it is sent to workers
    def called(instrument: str, config: EstimateConfig, function: Callable[..., Any], numbered: tuple[int, Any]) -> Any:
        key = _digest((instrument, config, function, numbered[1]))
        if key not in _ANSWERS:
            _ANSWERS[key] = pickle.dumps(call(instrument, config, function, numbered))
        return pickle.loads(_ANSWERS[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frames, "estimate_views", estimated)
        patch.setattr(instrument_processes, "_call", called)
        yield
