"""Seconds, silhouettes and rays a frame; frames a second against the number of processes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frame_run import run_frame
from dvrk_cmaes.io.frame_files import FrameFiles, read_frame
from dvrk_cmaes.io.session_folder import Session, read_session
from dvrk_cmaes.prepared import prepare
from dvrk_cmaes.result import Result

_ROUNDS = 2  # frames for nothing, for each process


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
    for folder in sessions:
        session = read_session(folder, known=names)
        if not everything:
            _one_by_one(session, instrument, config, 1)  # what is made at its first use
        results = _one_by_one(session, instrument, config, frames)
        everything += results
        rows.append(_summary("/".join(folder.parts[-2:]), results))
    return {"estimate, a frame": [*rows, _summary("all", everything)]}


def _summary(name: str, results: Sequence[Result]) -> dict[str, Any]:
    seconds = [result.seconds for result in results]
    return {
        "session": name,
        "frames": len(results),
        "seconds, median": float(np.median(seconds)),
        "seconds, most": float(np.max(seconds)),
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
