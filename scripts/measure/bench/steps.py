"""Steps of a running tracker, one by one: the processor time of each, what was drawn in it, and what the longest did.

    python scripts/bench.py steps --sessions RECORDING... --slowest 8

Recordings are followed as by `track --causal`; by images, as by `live`. The time is that of this process, of which the
steps take one thread: that which keyframes take to be solved is left out, as it goes on beside the steps. It depends
less on other load than that of the clock does, but is still some half longer on a busy machine. Each recording is
followed ``--repeats`` times, and a step counts with its shortest time.
"""

from __future__ import annotations

import argparse
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.track_clock import FRAMES_A_SECOND, TrackClock
from dvrk_cmaes.runs.track_frames import TrackSettings, files_of_views, read_arrays
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.silhouette.sliced_call import counted_work
from dvrk_cmaes.track import Tracker
from dvrk_cmaes.track.keyframe_problem import KeyframeProblem, KeyframeTask, Solution
from dvrk_cmaes.track.solution_schedule import SolutionSchedule
from measure.accuracy.track import recordings_to_follow
from measure.places import SHARED
from measure.recordings import Recording
from measure.tables import Report

_SHARES: Final = {"median": 50.0, "95 %": 95.0, "99 %": 99.0, "99.9 %": 99.9, "worst": 100.0}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--sessions", type=Path, nargs="+", default=[SHARED / "frames/video/hard"], metavar="SESSION")
    parser.add_argument("--evidence", choices=("masks", "images"), default="masks", help="default: %(default)s")
    parser.add_argument("--frames", type=int, metavar="N", help="largest number of frames of each (default: all)")
    parser.add_argument("--repeats", type=int, default=1, metavar="N", help="default: %(default)s")
    parser.add_argument("--slowest", type=int, default=5, metavar="N", help="steps that are described, of each")


def steps_report(options: argparse.Namespace) -> Report:
    """Follow recordings and return the times of their steps, and what the slowest did."""
    body = prepare(options.instrument)
    asked = TrackSettings(EstimateConfig(), causal=True, evidence=options.evidence)
    rows, slowest, every = [], [], list[_Step]()
    for folder in options.sessions:
        for recording, settings in recordings_to_follow(folder, body.instrument, asked):
            solver = _Solver(body)
            runs = [_followed(recording, settings, solver, options.frames) for _ in range(max(options.repeats, 1))]
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


@dataclass
class _Solver:
    """Solves keyframes at once, in this process; ``seconds`` is what that took of its time.

    Problems that are posed again, when a recording is followed again, are not solved again.
    """

    body: Body
    seconds: float = 0.0
    _solutions: deque[Solution] = field(default_factory=deque)
    _alone: dict[str, Result] = field(default_factory=dict)
    _known: dict[tuple[str, ...], Solution] = field(default_factory=dict)

    def begin(self, problem: KeyframeProblem) -> None:
        """Solve a problem."""
        began = time.process_time()
        names = tuple(keyframe.name for keyframe in problem.keyframes)
        if names not in self._known:
            alone = {name: self._alone[name] for name in names if name in self._alone}
            self._known[names] = replace(problem, alone={**alone, **problem.alone}).solve(self.body)
            self._alone = dict(self._known[names].alone)
        self._solutions.append(replace(self._known[names], base=problem.base))
        self.seconds += time.process_time() - began

    def prepare(self, tasks: Sequence[KeyframeTask]) -> None:
        """Do nothing: `begin` estimates the keyframes that it needs."""

    @property
    def ready(self) -> bool:
        """Whether the next solution is there."""
        return bool(self._solutions)

    def solution(self) -> Solution:
        """Return the next solution."""
        return self._solutions.popleft()


def _followed(recording: Recording, settings: TrackSettings, solver: _Solver, frames: int | None) -> list[_Step]:
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
    tracker = _tracker(session.rig, solver.body, settings)
    schedule = SolutionSchedule(tracker, solver) if settings.keeps_keyframes else None
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


def _tracker(rig: Rig, body: Body, settings: TrackSettings) -> Tracker:
    """Return a tracker none of whose steps is long."""
    if settings.keeps_keyframes:
        return settings.tracker(rig, body)
    return Tracker(rig, body, evidence=settings.evidence, sliced=True)
