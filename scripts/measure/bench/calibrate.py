"""Processor time of solving a session together, by stage, after its frames were estimated one by one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dvrk_cmaes.calibration.calibrate import calibrate_session
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.results.folder import read_results
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import estimate_frame
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare


def calibrate_report(
    instrument: str, sessions: Sequence[Path], *, frames: int | None, results: Path | None
) -> dict[str, Any]:
    """Measure the processor seconds of each stage of `calibrate_session`, in this process, for each session.

    ``results`` is a folder with results of all frames; by default the first ``frames`` of each session, or all, are
    estimated, which is not measured.
    """
    body = prepare(instrument)
    rows = []
    for folder in sessions:
        session = read_session(folder, known=body.instrument.joint_names)
        known = {} if results is None else read_results(results).frames
        used = _session_frames(session, body, known, frames)
        stages = {"lag and consensus": time.process_time()}

        def begin(stage: str, _: int, begun: dict[str, float] = stages) -> None:
            begun[stage] = time.process_time()

        solved = calibrate_session(used, body, series=session.reading_series(), progress=begin)
        ends = [*list(stages.values())[1:], time.process_time()]
        seconds = {stage: end - start for (stage, start), end in zip(stages.items(), ends, strict=True)}
        name = "/".join(folder.parts[-2:])
        rows.append(
            {"session": name, "frames": len(solved.calibration.frames), "all, s": sum(seconds.values()), **seconds}
        )
    return {"calibrate, processor seconds": rows}


def _session_frames(session: Session, body: Body, known: dict[str, Result], frames: int | None) -> list[SessionFrame]:
    """Read the frames of a session, and estimate those whose results are not known."""
    found = []
    for files in session.frames[:frames]:
        data = read_frame(files, session.camera)
        result = known.get(files.name)
        if result is None:
            result = estimate_frame(files, data, body, FrameMethod("classic", EstimateConfig()))
        found.append(SessionFrame(files.name, data, result, files.keypoints, files.time))
    return found
