"""A session folder and its frames' own results, solved together by several processes, and written.

OUT/session.json, OUT/frames/FRAME.json, OUT/overlays/FRAME.jpg, OUT/overlays_left_out/FRAME.jpg, OUT/poses.csv,
OUT/summary.json, OUT/report.html
"""

from __future__ import annotations

import csv
import functools
import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
from threadpoolctl import threadpool_limits

from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.atomic import write_bytes, write_json
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.times import parse_time
from dvrk_cmaes.results.folder import SESSION
from dvrk_cmaes.results.paths import check_output, left_out_path, mask_path, overlay_path, result_path
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.batch import finish
from dvrk_cmaes.runs.digests import frame_digests
from dvrk_cmaes.runs.manifest import manifest_of, write_manifest
from dvrk_cmaes.runs.worker import BatchSetup
from dvrk_cmaes.silhouette import Body

_of_this_process: dict[str, Any] = {}


def image_times(folder: Path) -> dict[str, float]:
    """Read the times of a session's frames, s, from images.csv, or else from joints.csv; none where neither says."""
    for name in ("images.csv", "joints.csv"):
        path = folder / name
        if not path.is_file():
            continue
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
            rows = [row for row in csv.DictReader(file) if row.get("frame") and row.get("time")]
        if rows:
            return {row["frame"].strip(): parse_time(str(path), row["time"]) / NANOSECONDS for row in rows}
    return {}


def calibrate_folder(
    session: Session,
    results: Mapping[str, Result],
    instrument: Instrument,
    out: Path,
    *,
    alone: Path | None = None,
    arm: Arm = "classic",
    config: EstimateConfig,
    workers: int,
    times: Mapping[str, float] | None = None,
    progress: Callable[[str, int], None] = lambda stage, count: None,
) -> SolvedSession:
    """Calibrate a session folder from its frames' own results, and write everything to a folder.

    ``alone`` is the folder of those results, with masks that were found in images and overlays of frames that are left
    out; ``times`` are frames', s.

    Raises
    ------
    InputError
        As `calibrate_session`; results of another instrument; a folder that cannot be written to.
    DvrkCmaesError
        A process died, or the disk is full.
    """
    frames = []
    for files in session.frames:
        check_output(out, files.name)
        if files.name not in results:
            continue
        result = results[files.name]
        if result.instrument != instrument.name:
            raise InputError(
                f"frame {files.name}: instrument: expected {instrument.name}, got a result of {result.instrument}"
            )
        reader = functools.partial(read_frame, _with_mask(files, alone), session.camera)
        at = None if times is None else times.get(files.name)
        frames.append(SessionFrame(files.name, reader, result, files.keypoints, at))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _start, (instrument, config)) as pool:

        def run(function: Callable[[Body, EstimateConfig, Any], Any], tasks: Sequence[Any]) -> list[Any]:
            return list(pool.map(functools.partial(_call, function), tasks))

        try:
            solved = calibrate_session(
                frames, instrument, arm=arm, config=config, run=run, draw=True, progress=progress
            )
        except BrokenExecutor:
            raise DvrkCmaesError("a process died, perhaps for want of memory: try fewer --workers") from None
    _write(solved, session, instrument, out, arm, config, alone)
    return solved


def _with_mask(files: FrameFiles, alone: Path | None) -> FrameFiles:
    if files.mask is not None or alone is None:
        return files
    mask = mask_path(alone, files.name)
    return replace(files, mask=mask if mask.exists() else None)


def _start(instrument: Instrument, config: EstimateConfig) -> None:
    """Prepare a process: its scenes, and one thread for its libraries."""
    cv2.setNumThreads(1)
    threadpool_limits(1)
    _of_this_process["body"], _of_this_process["config"] = Body.prepare(instrument), config


def _call(function: Callable[[Body, EstimateConfig, Any], Any], task: Any) -> Any:
    return function(_of_this_process["body"], _of_this_process["config"], task)


def _write(
    solved: SolvedSession,
    session: Session,
    instrument: Instrument,
    out: Path,
    arm: Arm,
    config: EstimateConfig,
    alone: Path | None,
) -> None:
    """Write results, overlays, tables and page; the calibration is there when its frames are."""
    (out / SESSION).unlink(missing_ok=True)
    for name, result in solved.results.items():
        if name in solved.pictures:
            solved.pictures[name].write(out, name)
        else:
            left_out_path(out, name).unlink(missing_ok=True)
            if alone is not None and overlay_path(alone, name).is_file():
                write_bytes(overlay_path(out, name), overlay_path(alone, name).read_bytes())
        write_json(result_path(out, name), result.to_dict())
    write_json(out / SESSION, solved.calibration.to_dict())
    setup = BatchSetup(instrument, session.camera, config, arm, session.folder)
    digests = {files.name: frame_digests(files) for files in session.frames if files.name in solved.results}
    write_manifest(out, manifest_of(setup, digests) | {"solved": "together"})
    finish(out)
