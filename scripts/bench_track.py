"""Latency of following an instrument, and memory after many steps."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.runs.track_clock import FRAMES_A_SECOND, TrackClock
from dvrk_cmaes.runs.track_frames import TrackSettings
from dvrk_cmaes.silhouette.prepare import prepare

_FIRST_STEPS = 1000  # after which memory is compared


def track_report(instrument: str, sessions: Sequence[Path], *, frames: int | None, steps: int | None) -> dict[str, Any]:
    """Measure the time of a step for each session and, with ``steps``, the memory of a tracker after so many."""
    report: dict[str, Any] = {"following, ms a step": [_latency(instrument, folder, frames) for folder in sessions]}
    if steps is not None:
        report["memory"] = [_memory(instrument, sessions[0], steps)]
    return report


def _latency(instrument: str, folder: Path, frames: int | None) -> dict[str, Any]:
    """Follow a session whose masks are read beforehand; steps with a global search are counted apart."""
    body = prepare(instrument)
    session = read_session(folder, known=body.instrument.joint_names)
    chosen = session.frames[:frames]
    clock = TrackClock.of(session, chosen, FRAMES_A_SECOND)
    masks = [read_frame(files, session.camera, blank=True).mask for files in chosen]
    tracker = TrackSettings(EstimateConfig()).tracker(session.camera, body)
    readings = iter(clock.readings)
    waiting = next(readings, None)
    elapsed, cpu, searched = [], [], []
    for files, mask in zip(chosen, masks, strict=True):
        at = clock.times[files.name]
        while waiting is not None and waiting[0] <= at + 1e-9:
            tracker.add_readings(*waiting)
            waiting = next(readings, None)
        began = time.process_time()
        result = tracker.step(at, mask)
        cpu.append(1e3 * (time.process_time() - began))
        elapsed.append(1e3 * result.seconds)
        searched.append(result.searched)
    usual = ~np.array(searched)
    row: dict[str, Any] = {"session": folder.name, "steps": int(usual.sum())}
    if usual.any():
        names = ("median", "95 %", "99 %", "worst")
        row |= dict(zip(names, np.percentile(np.array(elapsed)[usual], [50, 95, 99, 100]).tolist(), strict=True))
        row["CPU, median"] = float(np.median(np.array(cpu)[usual]))
    return row | {"first": elapsed[0], "searched": int(np.sum(searched))}


def _memory(instrument: str, folder: Path, steps: int) -> dict[str, Any]:
    """Follow the first frame of a session, which does not move, for many steps, and compare the memory used."""
    import psutil

    body = prepare(instrument)
    session = read_session(folder, known=body.instrument.joint_names)
    files = session.frames[0]
    mask = read_frame(files, session.camera).mask
    tracker = TrackSettings(EstimateConfig()).tracker(session.camera, body)
    process, early = psutil.Process(), 0
    for step in range(steps):
        at = step / FRAMES_A_SECOND
        tracker.add_readings(at, {name: value + 1e-6 * (step % 3) for name, value in files.readings.items()})
        tracker.step(at, mask)
        if step == min(_FIRST_STEPS, steps // 2):
            early = process.memory_info().rss
    late = process.memory_info().rss
    return {"steps": steps, "MB, early": early / 1e6, "MB, late": late / 1e6, "growth, %": 100 * (late / early - 1)}
