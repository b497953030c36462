"""Estimates of frames by commands and in Python, made once for the same inputs and settings and then shared.

For tests whose subject is what is done with results: an estimate takes some 0.4 s of processor time.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from dvrk_cmaes import EstimateConfig, Renderer, Result, prepare
from dvrk_cmaes.estimation import image_frame, one_tool
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.runs import frame as frames
from dvrk_cmaes.runs.manifest import digest_of
from dvrk_cmaes.track import keyframe_problem

MAKE = one_tool.estimate_views
_CALLERS = one_tool, image_frame, frames, keyframe_problem


@contextmanager
def shared_estimates() -> Iterator[None]:
    """Let frames that were estimated in this run of tests with the same inputs and settings have the same result again.

    Results are kept beside the tests' cache of instruments, which all processes of pytest-xdist share.
    """

    def estimated(
        views: Any,
        readings: Any,
        instrument: Any,
        method: FrameMethod,
        *,
        frame: str = "",
        time: Any = None,
        **more: Any,
    ) -> Result:
        body = prepare(instrument)
        given = pickle.dumps((views, dict(readings or {}), body.method, method, sorted(more.items())))
        key = digest_of(body.instrument) + hashlib.sha256(given).hexdigest()
        kept = Path(os.environ["DVRK_CMAES_CACHE"]).with_name("estimates") / key
        if not kept.exists():
            kept.parent.mkdir(exist_ok=True)
            made = kept.with_suffix(f".{os.getpid()}.{threading.get_ident()}")
            made.write_bytes(pickle.dumps(MAKE(views, readings, body, method, **more)))
            made.replace(kept)
        result: Result = pickle.loads(kept.read_bytes())
        return replace(result, frame=frame, time=time, renderer=Renderer(body, views[0].camera, threads=1))

    with _estimating_by(estimated):
        yield


def estimated_anew() -> AbstractContextManager[None]:
    """Let each estimate within `shared_estimates` be made."""
    return _estimating_by(MAKE)


@contextmanager
def _estimating_by(estimate_views: Callable[..., Result]) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for module in _CALLERS:
            patch.setattr(module, "estimate_views", estimate_views)
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
