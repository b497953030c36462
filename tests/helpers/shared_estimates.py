"""Estimates of frames by commands and batches, made once for the same inputs and settings and then shared.

For tests whose subject is what is done with results: an estimate takes some 0.4 s of processor time.
"""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from dvrk_cmaes import Body, EstimateConfig, Result
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.runs import frame as frames
from dvrk_cmaes.runs.manifest import digest_of


@contextmanager
def shared_estimates() -> Iterator[None]:
    """Let frames that were estimated in this run of tests with the same inputs and settings have the same result again.

    Results are kept beside the tests' cache of instruments, which all processes of pytest-xdist share.
    """
    estimate_views = frames.estimate_views

    def estimated(views: Any, readings: Any, body: Body, method: FrameMethod, **options: Any) -> Result:
        given = pickle.dumps((views, dict(readings), body.method, method, sorted(options.items())))
        key = digest_of(body.instrument) + hashlib.sha256(given).hexdigest()
        kept = Path(os.environ["DVRK_CMAES_CACHE"]).with_name("estimates") / key
        if not kept.exists():
            kept.parent.mkdir(exist_ok=True)
            made = kept.with_suffix(f".{os.getpid()}")
            made.write_bytes(pickle.dumps(estimate_views(views, readings, body, method, **options)))
            made.replace(kept)
        result: Result = pickle.loads(kept.read_bytes())
        return result

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
