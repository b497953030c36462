"""Latency of following an instrument, and memory after many steps."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import FrameFiles, read_frame, read_frame_image
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.runs.track_clock import FRAMES_A_SECOND, TrackClock
from dvrk_cmaes.runs.track_frames import TrackSettings
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.track.view_segmenter import EvidenceKind
from measure.accuracy.track import recordings_to_follow

_FIRST_STEPS = 1000  # after which memory is compared


def track_report(
    instrument: str,
    sessions: Sequence[Path],
    *,
    frames: int | None,
    steps: int | None,
    evidence: Sequence[EvidenceKind],
) -> dict[str, Any]:
    """Measure the time of a step by session and kind of evidence, and, with ``steps``, the memory after so many."""
    rows = [latency(instrument, folder, frames, kind) for folder in sessions for kind in evidence]
    report: dict[str, Any] = {"following, ms a step": rows}
    if steps is not None:
        report["memory"] = [_memory(instrument, sessions[0], steps)]
    return report


def latency(instrument: str, folder: Path, frames: int | None, evidence: EvidenceKind) -> dict[str, Any]:
    """Follow a session whose masks and images are read beforehand; steps with a global search are counted apart."""
    body = prepare(instrument)
    asked = TrackSettings(EstimateConfig(), evidence=evidence)
    recording, settings = recordings_to_follow(folder, body.instrument, asked)[0]
    session = recording.session
    chosen = session.frames[:frames]
    clock = TrackClock.of(session, chosen, FRAMES_A_SECOND)
    read = [_read(files, session.camera, evidence) for files in chosen]
    tracker = settings.tracker(Rig.of(session.camera), body)
    readings = iter(clock.readings)
    waiting = next(readings, None)
    elapsed, cpu, searched = [], [], []
    for files, (mask, image) in zip(chosen, read, strict=True):
        at = clock.times[files.name]
        while waiting is not None and waiting[0] <= at + 1e-9:
            tracker.add_readings(*waiting)
            waiting = next(readings, None)
        began = time.process_time()
        result = tracker.step(at, mask, image)
        cpu.append(1e3 * (time.process_time() - began))
        elapsed.append(1e3 * result.seconds)
        searched.append(result.searched)
    usual = ~np.array(searched)
    row: dict[str, Any] = {"session": folder.name, "evidence": evidence, "steps": int(usual.sum())}
    if usual.any():
        names = ("median", "95 %", "99 %", "worst")
        row |= dict(zip(names, np.percentile(np.array(elapsed)[usual], [50, 95, 99, 100]).tolist(), strict=True))
        row["CPU, median"], row["CPU, 99 %"] = np.percentile(np.array(cpu)[usual], [50, 99]).tolist()
    row["CPU, mean"] = float(np.mean(cpu))
    return row | {"first": elapsed[0], "searched": int(np.sum(searched))}


def _read(
    files: FrameFiles, camera: Camera, evidence: EvidenceKind
) -> tuple[NDArray[np.bool_] | None, NDArray[np.uint8] | None]:
    """Read the mask and the image of a frame that the evidence needs."""
    if files.mask is None:
        return None, read_frame_image(files, camera).image
    data = read_frame(files, camera, blank=True)
    return data.mask, None if evidence == "masks" else data.image


def _memory(instrument: str, folder: Path, steps: int) -> dict[str, Any]:
    """Follow the first frame of a session, which does not move, for many steps, and compare the memory used."""
    import psutil

    body = prepare(instrument)
    session = read_session(folder, known=body.instrument.joint_names)
    files = session.frames[0]
    mask = read_frame(files, session.camera).mask
    tracker = TrackSettings(EstimateConfig()).tracker(Rig.of(session.camera), body)
    process, early = psutil.Process(), 0
    for step in range(steps):
        at = step / FRAMES_A_SECOND
        tracker.add_readings(at, {name: value + 1e-6 * (step % 3) for name, value in files.readings.items()})
        tracker.step(at, mask)
        if step == min(_FIRST_STEPS, steps // 2):
            early = process.memory_info().rss
    late = process.memory_info().rss
    return {"steps": steps, "MB, early": early / 1e6, "MB, late": late / 1e6, "growth, %": 100 * (late / early - 1)}
