"""Seconds by stage, silhouettes and rays a frame; frames a second against the number of processes."""

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

from dvrk_cmaes import estimation, local_search
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import run_frame
from dvrk_cmaes.silhouette.prepare import prepare

_ROUNDS = 2  # frames for nothing, for each process


_STAGES = {
    "evidence": (estimation, "gather_evidence"),
    "search": (estimation, "find_candidates"),
    "refinement": (local_search.LocalSearch, "refine"),
    "quality": (estimation, "measure_quality"),
}
"""Where `estimate` spends its time: each stage's home and name."""


@contextmanager
def _stopwatches() -> Iterator[dict[str, list[float]]]:
    """Note the seconds of each call of each stage."""
    seconds: dict[str, list[float]] = {stage: [] for stage in _STAGES}

    def timed(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def measured(*given: Any, **named: Any) -> Any:
            begun = time.perf_counter()
            value = function(*given, **named)
            seconds[stage].append(time.perf_counter() - begun)
            return value

        return measured

    with ExitStack() as stack:
        for stage, (home, name) in _STAGES.items():
            stack.enter_context(mock.patch.object(home, name, timed(stage, getattr(home, name))))
        yield seconds


def _estimated(session: Session, files: FrameFiles, instrument: str, config: EstimateConfig) -> Result:
    data = read_frame(files, session.camera)
    return run_frame(files, data, prepare(instrument), arm="classic", config=config, out=None).result


def _one_by_one(session: Session, instrument: str, config: EstimateConfig, frames: int | None) -> list[Result]:
    return [_estimated(session, files, instrument, config) for files in session.frames[:frames]]


def estimate_report(instrument: str, sessions: Sequence[Path], *, frames: int | None) -> dict[str, Any]:
    """Seconds, silhouettes and rays a frame of each session and of all together."""
    names = prepare(instrument).instrument.joint_names
    config = EstimateConfig()
    rows: list[dict[str, Any]] = []
    everything: list[Result] = []
    stages: dict[str, list[float]] = {stage: [] for stage in _STAGES}
    for folder in sessions:
        session = read_session(folder, known=names)
        if not everything:
            _one_by_one(session, instrument, config, 1)  # what is made at its first use
        with _stopwatches() as watches:
            results = _one_by_one(session, instrument, config, frames)
        everything += results
        for stage, seconds in watches.items():
            stages[stage] += seconds
        rows.append(_summary("/".join(folder.parts[-2:]), results, watches))
    return {"estimate, a frame": [*rows, _summary("all", everything, stages)]}


def _summary(name: str, results: Sequence[Result], stages: Mapping[str, Sequence[float]]) -> dict[str, Any]:
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


def _ready(instrument: str) -> None:
    """Prepare the instrument in a fresh process."""
    prepare(instrument)


def workers_report(instrument: str, folder: Path, *, workers: Sequence[int], frames: int | None) -> dict[str, Any]:
    """Frames a second of a session's folder against the number of processes, each with one thread.

    Processes are started and ready before the clock is.
    """
    session = read_session(folder, known=prepare(instrument).instrument.joint_names)
    files = session.frames[:frames]
    config = replace(EstimateConfig(), threads=1)
    rows = []
    for count in workers:
        with ProcessPoolExecutor(count, get_context("spawn"), _ready, (instrument,)) as pool:
            rounds = range(_ROUNDS * count)
            warm = [pool.submit(_estimated, session, files[0], instrument, config) for _ in rounds]
            for one in warm:
                one.result()
            start = time.perf_counter()
            done = [pool.submit(_estimated, session, one, instrument, config) for one in files]
            for one in done:
                one.result()
            rows.append({"processes": count, "frames a second": len(files) / (time.perf_counter() - start)})
    return {"a folder": rows}
