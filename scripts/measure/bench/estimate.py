"""Seconds by stage, silhouettes and rays a frame; frames a second by number of processes."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation import one_tool as estimation
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.pose import find_pose
from dvrk_cmaes.pose.refine.coarse_to_fine import LocalSearch
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import run_frame
from dvrk_cmaes.silhouette.prepare import prepare

_WARM_UP_FRAMES = 2  # frames for each process, not measured


_STAGES = {
    "evidence": (estimation, "gather_evidence"),
    "search": (find_pose, "find_candidates"),
    "refinement": (LocalSearch, "refine"),
    "quality": (find_pose, "measure_modes"),
}
"""The measured stages of `estimate`: module or class, and name of the function."""


@contextmanager
def _timed_stages() -> Iterator[dict[str, list[float]]]:
    """Record the seconds of each call of each stage."""
    seconds: dict[str, list[float]] = {stage: [] for stage in _STAGES}

    def timed(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def measured(*given: Any, **named: Any) -> Any:
            started = time.perf_counter()
            value = function(*given, **named)
            seconds[stage].append(time.perf_counter() - started)
            return value

        return measured

    with ExitStack() as stack:
        for stage, (owner, name) in _STAGES.items():
            stack.enter_context(mock.patch.object(owner, name, timed(stage, getattr(owner, name))))
        yield seconds


def estimated(session: Session, files: FrameFiles, instrument: str, config: EstimateConfig) -> Result:
    """Estimate one frame."""
    data = read_frame(files, session.camera)
    return run_frame(files, data, prepare(instrument), FrameMethod("classic", config), None)[0]


def _one_by_one(session: Session, instrument: str, config: EstimateConfig, frames: int | None) -> list[Result]:
    """Estimate the first ``frames`` frames of a session, or all, in this process."""
    return [estimated(session, files, instrument, config) for files in session.frames[:frames]]


def estimate_report(instrument: str, sessions: Sequence[Path], *, frames: int | None) -> dict[str, Any]:
    """Measure seconds, silhouettes and rays a frame, for each session and for all of them together."""
    names = prepare(instrument).instrument.joint_names
    config = EstimateConfig()
    rows: list[dict[str, Any]] = []
    everything: list[Result] = []
    stages: dict[str, list[float]] = {stage: [] for stage in _STAGES}
    for folder in sessions:
        session = read_session(folder, known=names)
        if not everything:
            _one_by_one(session, instrument, config, 1)  # so that caches are filled before the measurement
        with _timed_stages() as timed:
            results = _one_by_one(session, instrument, config, frames)
        everything += results
        for stage, seconds in timed.items():
            stages[stage] += seconds
        rows.append(_summary("/".join(folder.parts[-2:]), results, timed))
    return {"estimate, a frame": [*rows, _summary("all", everything, stages)]}


def _summary(name: str, results: Sequence[Result], stages: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Return a row of medians over results."""
    seconds = [result.seconds for result in results]
    return {
        "session": name,
        "frames": len(results),
        "seconds, median": float(np.median(seconds)),
        "seconds, most": float(np.max(seconds)),
        **{f"{stage}, seconds": float(np.median(times)) for stage, times in stages.items()},
        "silhouettes": float(np.median([result.evaluations for result in results])),
        "rays": float(np.median([result.rays for result in results])),
    }


def _prepare_worker(instrument: str) -> None:
    """Prepare the instrument in a worker process."""
    prepare(instrument)


def workers_report(instrument: str, folder: Path, *, workers: Sequence[int], frames: int | None) -> dict[str, Any]:
    """Measure frames a second of a session by number of processes, each with one thread.

    The processes are started and have estimated some frames before the measurement starts.
    """
    session = read_session(folder, known=prepare(instrument).instrument.joint_names)
    files = session.frames[:frames]
    config = replace(EstimateConfig(), threads=1)
    rows = []
    for count in workers:
        with ProcessPoolExecutor(count, get_context("spawn"), _prepare_worker, (instrument,)) as pool:
            warm_up = range(_WARM_UP_FRAMES * count)
            first = [pool.submit(estimated, session, files[0], instrument, config) for _ in warm_up]
            for one in first:
                one.result()
            start = time.perf_counter()
            done = [pool.submit(estimated, session, one, instrument, config) for one in files]
            for one in done:
                one.result()
            rows.append({"processes": count, "frames a second": len(files) / (time.perf_counter() - start)})
    return {"a folder": rows}
