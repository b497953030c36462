"""Estimates of frames by commands and batches, made once for the same inputs and settings and then shared.

For tests whose subject is what is done with results: an estimate takes some 0.4 s of processor time.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import pytest

from dvrk_cmaes import Body, EstimateConfig, Result
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.runs import frame as frames
from dvrk_cmaes.runs.manifest import instrument_digest

_KNOWN: dict[str, Result] = {}


@contextmanager
def shared_estimates() -> Iterator[None]:
    """Let frames that were estimated in this process with the same inputs and settings have the same result again."""
    estimate_views = frames.estimate_views

    def estimated(views: Any, readings: Any, body: Body, method: FrameMethod, **options: Any) -> Result:
        given = pickle.dumps((views, dict(readings), body.method, method, sorted(options.items())))
        key = instrument_digest(body.instrument) + hashlib.sha256(given).hexdigest()
        if key not in _KNOWN:
            _KNOWN[key] = estimate_views(views, readings, body, method, **options)
        return _KNOWN[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frames, "estimate_views", estimated)
        yield


@contextmanager
def short_searches() -> Iterator[None]:
    """Let searches whose settings are not given be of a third of the usual candidates."""
    usual = EstimateConfig().search
    values = {field.name: getattr(usual, field.name) for field in fields(usual)}
    values |= {"samples": 256, "starts": 8, "evaluations": 320}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(usual).__init__, "__defaults__", tuple(values.values()))
        yield
