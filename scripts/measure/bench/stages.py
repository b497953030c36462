"""Where the processor time of `estimate` goes: each stage without the stages inside it, and its share."""

from __future__ import annotations

import functools
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation import one_tool as estimation
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.pose import find_pose, views
from dvrk_cmaes.pose.refine import coarse_to_fine
from dvrk_cmaes.pose.terms.contour import CorrelatedContour
from dvrk_cmaes.pose.terms.outline_term import OutlineTerm
from dvrk_cmaes.runs.frame import estimate_frame
from dvrk_cmaes.silhouette.prepare import prepare

_REST, _OUTSIDE = "rest", "outside"
_SIZES = {1: "refinement, whole size", 2: "refinement, half size"}  # of images at most 1,000 px wide
_SMALL = "refinement, smaller sizes"


def _stage(outline: OutlineTerm[Any], *_: Any, **__: Any) -> str:
    """Name the stage of a refinement by its term and image size."""
    if isinstance(outline, CorrelatedContour):
        return "refinement, correlated errors"
    return _SIZES.get(outline.views[0].shrink, _SMALL)


_STAGES: tuple[tuple[Any, str, str | Callable[..., str]], ...] = (
    (estimation, "gather_evidence", "evidence of the mask"),
    (find_pose, "find_candidates", "search"),
    (coarse_to_fine, "refine", _stage),
    (views, "measure_noise", "errors of the contour"),
    (coarse_to_fine, "information_of_views", "covariance"),
    (find_pose, "measure_modes", "quality, and rays that confirm it"),
)
"""Module or class, name of the function, and the stage that its time counts for."""


class _Clock:
    """Adds up the processor time of the stage that runs; a stage inside another stops the other's time."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._running = [_OUTSIDE]
        self._since = time.process_time()

    def _count(self) -> None:
        now = time.process_time()
        self.seconds[self._running[-1]] += now - self._since
        self._since = now

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time until the end for a stage."""
        self._count()
        self._running.append(name)
        try:
            yield
        finally:
            self._count()
            self._running.pop()


def _timed(clock: _Clock, function: Callable[..., Any], stage: str | Callable[..., str]) -> Callable[..., Any]:
    """Return the function with its time counted for a stage, or for the one that its arguments name."""

    @functools.wraps(function)
    def measured(*given: Any, **named: Any) -> Any:
        with clock.stage(stage if isinstance(stage, str) else stage(*given, **named)):
            return function(*given, **named)

    return measured


def stages_report(instrument: str, sessions: Sequence[Path], *, frames: int | None) -> dict[str, Any]:
    """Measure the processor time of each stage of `estimate`, ms a frame, mean over the sessions' first ``frames``."""
    body, config = prepare(instrument), EstimateConfig()
    clock, count = _Clock(), 0
    for folder in sessions:
        session = read_session(folder, known=body.instrument.joint_names)
        for files in session.frames[:frames]:
            data = read_frame(files, session.camera)
            if not count:
                estimate_frame(files, data, body, FrameMethod("classic", config))  # so that caches are filled
            with ExitStack() as stack:
                for owner, name, stage in _STAGES:
                    timed = _timed(clock, getattr(owner, name), stage)
                    stack.enter_context(mock.patch.object(owner, name, timed))
                with clock.stage(_REST):
                    estimate_frame(files, data, body, FrameMethod("classic", config))
            count += 1
    return {"estimate, where the processor time goes": _rows(clock.seconds, count)}


def _rows(seconds: dict[str, float], frames: int) -> list[dict[str, Any]]:
    """Return a row for each stage, the longest first, and one for all."""
    of_stages = {stage: value for stage, value in seconds.items() if stage != _OUTSIDE}
    whole = sum(of_stages.values())
    longest = sorted(of_stages.items(), key=lambda item: -item[1])
    return [
        {"stage": stage, "ms a frame": 1e3 * value / frames, "share, %": 100 * value / whole}
        for stage, value in [*longest, (f"all, {frames} frames", whole)]
    ]
