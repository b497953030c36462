"""Steps of a running tracker, one by one: the processor time of each, what was drawn in it, and what the longest did.

    python scripts/bench.py steps --sessions RECORDING... --slowest 8

Recordings are followed as by `track --causal`; by images, as by `live`. The time is that of this process, of which the
steps take one thread: that which keyframes take to be solved is left out, as it goes on beside the steps. It depends
less on other load than that of the clock does, but is still some half longer on a busy machine. Each recording is
followed ``--repeats`` times, and a step counts with its shortest time. By a given ``--calibration`` no keyframes are
solved.
"""

from __future__ import annotations

import argparse
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration, read_calibration
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.runs.track_clock import FRAMES_A_SECOND, TrackClock
from dvrk_cmaes.runs.track_frames import TrackSettings, files_of_views, read_arrays
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.silhouette.sliced_call import counted_work
from dvrk_cmaes.track import Tracker
from dvrk_cmaes.track.solution_schedule import SolutionSchedule
from measure.accuracy.track import recordings_to_follow
from measure.places import SHARED
from measure.recordings import Recording
from measure.solver import SolverHere
from measure.tables import Report

_SHARES: Final = {"median": 50.0, "95 %": 95.0, "99 %": 99.0, "99.9 %": 99.9, "worst": 100.0}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--sessions", type=Path, nargs="+", default=[SHARED / "frames/video/hard"], metavar="SESSION")
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="follow by this session.json instead of by keyframes"
    )
    parser.add_argument("--evidence", choices=("masks", "images"), default="masks", help="default: %(default)s")
    parser.add_argument("--frames", type=int, metavar="N", help="largest number of frames of each (default: all)")
    parser.add_argument("--repeats", type=int, default=1, metavar="N", help="default: %(default)s")
    parser.add_argument("--slowest", type=int, default=5, metavar="N", help="steps that are described, of each")


def steps_report(options: argparse.Namespace) -> Report:
    """Follow recordings and return the times of their steps, and what the slowest did."""
    body = prepare(options.instrument)
    asked = TrackSettings(EstimateConfig(), causal=True, evidence=options.evidence)
    rows, slowest, every = [], [], list[_Step]()
    given = None if options.calibration is None else read_calibration(options.calibration)
    for folder in options.sessions:
        for recording, settings in recordings_to_follow(folder, body.instrument, asked):
            solver = SolverHere(body)
            runs = [
                _followed(recording, settings, solver, options.frames, given) for _ in range(max(options.repeats, 1))
            ]
            steps = [min(same, key=lambda step: step.ms) for same in zip(*runs, strict=True)]
            rows.append({"session": recording.name, **_figures(steps)})
            longest = sorted(steps, key=lambda step: -step.ms)[: options.slowest]
            slowest += [{"session": recording.name, **step.described()} for step in longest]
            every += steps
    rows.append({"session": "all", **_figures(every)})
    return {"processor time of a step, ms": rows, "the slowest": slowest}


@dataclass(frozen=True)
class _Step:
    """A step: its frame, time, ms, what was drawn, and what it returned; ``calibrated`` if by a calibration."""

    frame: str
    ms: float
    drawings: int
    rows: int
    status: str
    reasons: tuple[str, ...]
    calibrated: bool

    def described(self) -> dict[str, Any]:
        """Return the row of a step that took long."""
        return {
            "frame": self.frame,
            "ms": self.ms,
            "drawings": self.drawings,
            "rows": self.rows,
            "calibrated": self.calibrated,
            "status": self.status,
            "reasons": "; ".join(self.reasons)[:90],
        }


def _figures(steps: Sequence[_Step]) -> dict[str, Any]:
    """Return the figures of steps."""
    times = np.array([step.ms for step in steps])
    shares = {name: float(np.percentile(times, share)) for name, share in _SHARES.items()}
    most = {"most drawings": max(step.drawings for step in steps), "most rows": max(step.rows for step in steps)}
    return {"steps": len(steps), **shares, **most}


def _followed(
    recording: Recording,
    settings: TrackSettings,
    solver: SolverHere,
    frames: int | None,
    given: SessionCalibration | None,
) -> list[_Step]:
    """Follow a recording whose masks and images are read beforehand, and measure each step."""
    session = recording.session
    chosen = session.frames[:frames]
    clock = TrackClock.of(session, chosen, FRAMES_A_SECOND)
    read = [
        {
            name: read_arrays(files, session.rig.view(name).camera)
            for name, files in files_of_views(one, session.rig).items()
        }
        for one in chosen
    ]
    tracker = Tracker(session.rig, solver.body, given, evidence=settings.evidence, sliced=True)
    schedule = SolutionSchedule(tracker, solver) if settings.keeps_keyframes and given is None else None
    readings, steps = deque(clock.readings), list[_Step]()
    for files, arrays in zip(chosen, read, strict=True):
        at = clock.times[files.name]
        while readings and readings[0][0] <= at + 1e-9:
            tracker.add_readings(*readings.popleft())
        by_images = settings.evidence == "images"
        images = {name: image for name, (image, _, _) in arrays.items()} if by_images else None
        masks = {name: mask for name, (_, mask, _) in arrays.items()}
        ignored = {name: ignore for name, (_, _, ignore) in arrays.items()}
        solving, began = solver.seconds, time.process_time()
        with counted_work() as work:
            if schedule is not None:
                schedule.before_step(at)
            result = tracker.step(at, masks, images, ignored)
            drawings, rows = work.drawings, work.rows
            if schedule is not None:
                schedule.after_step(at)
        used = time.process_time() - began - (solver.seconds - solving)
        calibrated = result.base is not None and result.base.used
        steps.append(_Step(files.name, 1e3 * used, drawings, rows, result.status, result.reasons, calibrated))
    return steps
