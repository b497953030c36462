"""A session on its way to its calibration: frames and session in turn, until they have settled.

First the base that most frames' modes agree on, and what is wrong with the session as a whole; then rounds: each frame
on its own outline as the session expects it, and the session from what all outlines say; then a report on each frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.consensus import Mode, choose_modes, find_consensus
from dvrk_cmaes.calibration.faults import check_arm, check_motion, find_lag, find_move, shifted
from dvrk_cmaes.calibration.frame_fit import FrameView, PoseAndJoints
from dvrk_cmaes.calibration.frame_task import FitTask, FrameReport, ReportTask, SessionFrame, fit_task, report_task
from dvrk_cmaes.calibration.model import SessionModel, Spreads, outer_readings
from dvrk_cmaes.calibration.solve import FrameViews, deviations, solve, without
from dvrk_cmaes.calibration.variances import learn_spreads
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evidence.joint_prior import describe_limits
from dvrk_cmaes.geometry import inverse, moved
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body

Float64 = NDArray[np.float64]
T = TypeVar("T")
R = TypeVar("R")

LEAST_FRAMES = 3
_CHOICES = 5  # times that modes are chosen anew
_SETTLING = 3  # solutions of the session between two of its frames
_TURNED_ROUNDS = 2  # in which other turns about the shaft are tried
_SLIP = 4.0  # spreads
_LEAST_OVERLAP = 0.5  # for a frame that says anything
_TRUSTED_SHARE = 0.5  # of the frames: fewer that agree may do so by accident
_LESS_OVERLAP = 0.1  # than by itself, for a frame that the session still explains

Run = Callable[[Callable[[Body, EstimateConfig, T], R], Sequence[T]], list[R]]
"""Applies a function of body, settings and task to all tasks, in their order."""


class SessionRounds:
    """The state of a session on its way to its calibration."""

    def __init__(
        self,
        frames: list[SessionFrame],
        instrument: Instrument,
        arm: Arm,
        config: EstimateConfig,
        run: Run[Any, Any],
        progress: Callable[[str, int], None],
    ) -> None:
        self.frames = frames
        self._instrument = instrument
        self._arm: Arm = arm
        self._config = config
        self._run = run
        self._progress = progress
        self.warnings: list[str] = []
        self.lag: dict[str, float] | None = None
        self._moved: dict[str, str] = {}
        names = instrument.joint_names
        joints = np.array([[f.result.readings.get(name, np.nan) for name in names] for f in frames])
        spreads = Spreads.of(config.session, names)
        outer = outer_readings([f.result.readings for f in frames])
        self.model = SessionModel(outer, joints, names, spreads, arm=arm, roll_offset=instrument.roll_offset)
        session = config.session
        spread = np.deg2rad([session.roll_offset_deg, *(config.readings.of(name) for name in names)])
        self._offset_spread = np.array([session.insertion_offset_mm * 1e-3, *spread])
        self._prior = np.zeros((8 + len(names),) * 2)
        self._prior[6:, 6:] = np.diag(1 / self._offset_spread**2)
        self._modes = [self._modes_of(frame.result) for frame in frames]

    def _joints(self, joints: dict[str, float]) -> Float64:
        return np.array([joints[name] for name in self._instrument.joint_names])

    def _modes_of(self, result: Result) -> list[Mode]:
        assert result.camera_from_root is not None
        assert result.covariance is not None
        own = [Mode(result.camera_from_root, self._joints(result.joints), result.covariance)]
        others = [Mode(a.camera_from_root, self._joints(a.joints), result.covariance) for a in result.alternatives]
        return own + others

    def choose(self) -> None:
        """Find the base that most frames agree on, each frame's mode for it, and what is wrong with the session."""
        check_motion(self.model)
        lag = find_lag(self.model, self._modes, self._offset_spread)
        if lag:
            self._take_out(lag)
        consensus = find_consensus(self.model, self._modes, self._offset_spread)
        check_arm(self.model, self._modes, self._offset_spread, consensus)
        move = find_move(self.model, self._modes, self._offset_spread, consensus)
        if move is not None:
            before, after = (self.frames[i].name for i in move.between)
            text = f"the arm's base or the camera moved between frames {before} and {after}"
            self.warnings.append(f"{text}: calibrated for the {move.side} of them")
            self._moved = {self.frames[i].name: text for i in move.others}
            kept = [i for i, frame in enumerate(self.frames) if frame.name not in self._moved]
            self._keep(kept)
            consensus = find_consensus(self.model, self._modes, self._offset_spread)
        calibration = consensus.calibration
        chosen, _ = choose_modes(self.model, self._modes, calibration)
        for _ in range(_CHOICES):
            self.solution = solve(self.model, _as_views(chosen), calibration, self._prior)
            calibration, before_ = self.solution.calibration, chosen
            chosen, _ = choose_modes(self.model, self._modes, calibration)
            if all(a is b for a, b in zip(chosen, before_, strict=True)):
                break

    def _take_out(self, lag: int) -> None:
        """Let each frame have the readings that belong to it, ``lag`` frames later."""
        late = "late" if lag > 0 else "early"
        self.lag = {"frames": float(lag)}
        times = [frame.time for frame in self.frames]
        text = f"readings come {abs(lag)} frames {late}"
        known = [t for t in times if t is not None]
        if len(known) == len(times):
            self.lag["seconds"] = round(lag * float(np.median(np.diff(known))), 6)
            text += f" ({abs(self.lag['seconds']):g} s)"
        self.warnings.append(f"{text}: taken out")
        model, kept = shifted(self.model, lag)
        for i, frame in enumerate(self.frames):
            if i not in kept:
                self._moved[frame.name] = "no readings once the lag is taken out"
        self.frames = [self.frames[i] for i in kept]
        self._modes = [self._modes[i] for i in kept]
        self.model = model
        for i, frame in enumerate(self.frames):
            names = ("yaw", "pitch", "insertion", "roll", *self._instrument.joint_names)
            values = (*model.outer[i], *model.joints[i])
            readings = {n: float(v) for n, v in zip(names, values, strict=True) if not np.isnan(v)}
            self.frames[i] = replace(frame, result=replace(frame.result, readings=readings))
        if len(kept) < LEAST_FRAMES:
            raise InputError(f"session: {text}, which leaves {len(kept)} frames; expected at least {LEAST_FRAMES}")

    def _keep(self, kept: list[int]) -> None:
        self.frames = [self.frames[i] for i in kept]
        self._modes = [self._modes[i] for i in kept]
        self.model = self.model.subset(kept)

    def settle(self) -> None:
        """Solve frames and session in turn."""
        session = self._config.session
        looser = [*np.geomspace(session.loosened, 1.0, max(session.rounds - 1, 1)).tolist(), 1.0]
        calibration = self.solution.calibration
        starts: list[tuple[PoseAndJoints, ...]] = [
            tuple((mode.camera_from_root, mode.joints) for mode in modes) for modes in self._modes
        ]
        for turn, loosened in enumerate(looser[: session.rounds]):
            self._progress(f"round {turn + 1} of {session.rounds}", len(self.frames))
            expected = self.model.priors(calibration, loosened=loosened)
            tasks = []
            for i, frame in enumerate(self.frames):
                prior, own = expected[i], self._modes[i][0]
                more = [(prior.camera_from_root, prior.joints)]
                if turn < _TURNED_ROUNDS:
                    for angle in (-session.turn_deg, session.turn_deg):
                        more.append((_turned(prior.camera_from_root, angle), prior.joints))
                tasks.append(FitTask(frame, prior, (*starts[i], *more), (own.camera_from_root, own.joints)))
            self.views: list[FrameView] = self._run(fit_task, tasks)
            starts = [((view.camera_from_root, view.joints),) for view in self.views]
            settled = loosened == 1.0
            stacked = _stacked(
                [view if _explains(view) or not settled else view.without_outline() for view in self.views]
            )
            for _ in range(_SETTLING):
                self.solution = solve(self.model, stacked, calibration, self._prior)
                calibration = self.solution.calibration
                self.model = learn_spreads(self.model, stacked, calibration, self.solution.weights, session)
        self.solution = solve(self.model, stacked, calibration, self._prior)

    def report(self, draw: bool) -> tuple[list[FrameReport], dict[str, str]]:
        """Report on each frame, and say which were left out and why."""
        self._progress("leaving one out", len(self.frames))
        solution, session = self.solution, self._config.session
        dimension = 6 + len(self.model.names)
        fits, explained = solution.misfit < session.largest_misfit * dimension, [_explains(v) for v in self.views]
        agree = fits & explained
        if agree.sum() < LEAST_FRAMES:
            raise InputError(
                f"session: expected at least {LEAST_FRAMES} frames that agree on where the arm's base is, "
                f"got {agree.sum()} of {len(agree)}"
            )
        if agree.sum() < _TRUSTED_SHARE * len(agree):
            self.warnings.append(
                f"only {agree.sum()} of {len(agree)} frames agree on where the arm's base is: the others' masks or the "
                "readings are wrong, or these few are"
            )
        covariance = deviations(self.model, _stacked(self.views), solution)
        reached = self.model.base_from_root(solution.calibration.offsets)
        reasons = dict(self._moved)
        tasks = []
        for i, (frame, view) in enumerate(zip(self.frames, self.views, strict=True)):
            doubts = self._slips(i)
            if not agree[i]:
                worst = np.sqrt(solution.misfit[i] / dimension)
                text = "disagrees with the session: "
                if fits[i]:
                    text += (
                        f"what it expects does not explain the mask (IoU {view.iou:.2f}, by itself {view.own_iou:.2f})"
                    )
                else:
                    text += f"{worst:.1f} times the expected error from what it expects"
                reasons[frame.name] = text
                doubts = [text, *doubts]
            poses, joints = self.model.subset([i]).predict(without(solution, i))
            tasks.append(
                ReportTask(
                    frame,
                    view,
                    covariance[i],
                    (poses[0], joints[0]),
                    np.asarray(view.camera_from_root @ inverse(reached[i])),
                    tuple(doubts),
                    bool(agree[i]),
                    draw=draw,
                    config={**self._config.as_dict(), "instrument": describe_limits(self._instrument, self._arm)},
                )
            )
        return self._run(report_task, tasks), reasons

    def _slips(self, i: int) -> list[str]:
        """Name the joints whose readings are far off in this frame alone."""
        spread = [self.model.spreads.outer[3], *self.model.spreads.joints]
        found = []
        for name, times, one in zip(("roll", *self.model.names), self.model.stretch[i], spread, strict=True):
            off = times * self._config.session.tail
            if off > _SLIP:
                found.append(
                    f"reading of {name}: {np.degrees(off * one):.0f} deg off in this frame, beyond the session's offset"
                )
        return found


def _explains(view: FrameView) -> bool:
    """Whether a frame's mask is explained as its session expects it, too, and not only by itself."""
    return view.iou > max(view.own_iou - _LESS_OVERLAP, _LEAST_OVERLAP)


def _turned(pose: Float64, degrees: float) -> Float64:
    return moved(pose, np.array([0, 0, 0, 0, 0, np.deg2rad(degrees)]))


def _as_views(modes: Sequence[Mode]) -> FrameViews:
    information = np.linalg.inv(np.array([mode.covariance for mode in modes]))
    poses = np.array([mode.camera_from_root for mode in modes])
    joints = np.array([mode.joints for mode in modes])
    return FrameViews(poses, joints, information, np.zeros(information.shape[:2]))


def _stacked(views: Sequence[FrameView]) -> FrameViews:
    return FrameViews(
        np.array([view.camera_from_root for view in views]),
        np.array([view.joints for view in views]),
        np.array([view.information for view in views]),
        np.array([view.slope for view in views]),
    )
