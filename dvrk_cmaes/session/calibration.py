"""Solve a session's frames together: one camera_from_base and one offset a joint, and every frame again with these.

First the base that most frames' modes agree on; then in turn each frame on its own outline, as the session expects it,
and the session from what all outlines say, until the frames have settled.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.arm import Arm
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.config_check import check_config
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import inverse, moved
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joint_readings import describe_limits
from dvrk_cmaes.parallel import each
from dvrk_cmaes.prepared import prepare
from dvrk_cmaes.report.files import FramePictures
from dvrk_cmaes.result import Result
from dvrk_cmaes.session.consensus import Mode, choose_modes, find_consensus
from dvrk_cmaes.session.document import SessionCalibration, describe_solution
from dvrk_cmaes.session.faults import check_arm, check_motion, find_lag, find_move, shifted
from dvrk_cmaes.session.frame_fit import FrameView, PoseAndJoints
from dvrk_cmaes.session.frame_task import FitTask, FrameReport, ReportTask, SessionFrame, fit_task, report_task
from dvrk_cmaes.session.model import SessionModel, Spreads, outer_readings
from dvrk_cmaes.session.solve import FrameViews, deviations, solve, without
from dvrk_cmaes.session.spreads import learn_spreads
from dvrk_cmaes.silhouette import Body

Float64 = NDArray[np.float64]
T = TypeVar("T")
R = TypeVar("R")

_LEAST_FRAMES = 3
_CHOICES = 5  # times that modes are chosen anew
_SETTLING = 3  # solutions of the session between two of its frames
_TURNED_ROUNDS = 2  # in which other turns about the shaft are tried
_SLIP = 4.0  # spreads

Run = Callable[[Callable[[Body, EstimateConfig, T], R], Sequence[T]], list[R]]
"""Applies a function of body, settings and task to all tasks, in their order."""


@dataclass(frozen=True, eq=False)
class SolvedSession:
    """A session's calibration, and all its frames' results by name: solved again, or as they were.

    ``pictures`` by name, where they were asked for.
    """

    calibration: SessionCalibration
    results: dict[str, Result]
    pictures: dict[str, FramePictures]


def calibrate_session(
    frames: Sequence[SessionFrame],
    instrument: Instrument | Body | str = "lnd",
    *,
    arm: Arm = "classic",
    config: EstimateConfig | None = None,
    run: Run[Any, Any] | None = None,
    draw: bool = False,
    progress: Callable[[str, int], None] = lambda stage, count: None,
) -> SolvedSession:
    """Calibrate a session: camera_from_base, and the offsets of its joint readings.

    Parameters
    ----------
    frames
        Frames in the order they were taken, each with its own result (of `estimate`), whose readings must have the
        outer joints yaw, pitch, insertion and roll. Frames without, and failed ones, are left out.
    instrument
        As in `estimate`.
    arm
        The kinematics of the outer arm.
    config
        All settings; ``config.session`` says how frames hang together.
    run
        How to apply a function to many tasks; two threads unless given.
    draw
        Draw each frame, too: its result, and what the other frames predict.
    progress
        Told the stage and the number of frames that it is about to solve.

    Raises
    ------
    InputError
        Fewer than three usable frames; an arm that does not move; readings that only fit another arm or tool.
    """
    settings = EstimateConfig() if config is None else config
    check_config(settings)
    body = instrument if isinstance(instrument, Body) else prepare(instrument)
    started = time.perf_counter()
    if run is None:
        run = partial(_in_threads, body, settings)
    usable, left_out = _usable(frames, body.instrument)
    work = _Session(usable, body.instrument, arm, settings, run, progress)
    work.choose()
    work.settle()
    reports, reasons = work.report(draw)
    results = {frame.name: frame.result for frame in frames}
    results |= {frame.name: one.result for frame, one in zip(work.frames, reports, strict=True)}
    left_out |= reasons
    used = [results[frame.name].quality for frame in work.frames if frame.name not in left_out]
    known = [quality for quality in used if quality is not None]
    described = describe_solution(work.model, work.solution, settings, body.instrument)
    calibration = SessionCalibration(
        instrument=body.instrument.name,
        arm=arm,
        roll_offset=body.instrument.roll_offset,
        frames=tuple(frame.name for frame in work.frames if frame.name not in left_out),
        left_out=dict(sorted(left_out.items())),
        leave_one_out={
            frame.name: (one.left_out_iou, one.left_out_px)
            for frame, one in zip(work.frames, reports, strict=True)
            if frame.name not in left_out
        },
        iou=float(np.median([quality.iou for quality in known])) if known else 0.0,
        contour_px_95=float(np.median([quality.contour_px_95 for quality in known])) if known else 0.0,
        lag=work.lag,
        warnings=tuple(work.warnings),
        seconds=time.perf_counter() - started,
        config={**settings.as_dict(), "instrument": describe_limits(body.instrument, arm)},
        **described,
    )
    pictures = {one.result.frame: one.pictures for one in reports if one.pictures is not None}
    return SolvedSession(calibration, results, pictures)


def _in_threads(
    body: Body, config: EstimateConfig, function: Callable[[Body, EstimateConfig, T], R], tasks: Sequence[T]
) -> list[R]:
    return each(lambda task: function(body, config, task), tasks, config.threads)


def _usable(frames: Sequence[SessionFrame], instrument: Instrument) -> tuple[list[SessionFrame], dict[str, str]]:
    """Sort out frames that say nothing about the base, with the reason."""
    left_out = {}
    for frame in frames:
        if frame.result.camera_from_root is None or frame.result.covariance is None:
            left_out[frame.name] = "no pose: " + "; ".join(frame.result.reasons or ("the frame failed",))
        elif np.isnan(outer_readings([frame.result.readings])).any():
            left_out[frame.name] = "no readings of all outer joints (yaw, pitch, insertion, roll)"
    usable = [frame for frame in frames if frame.name not in left_out]
    if len(usable) < _LEAST_FRAMES:
        why = "; ".join(dict.fromkeys(left_out.values())) or "no more were given"
        raise InputError(f"session: expected at least {_LEAST_FRAMES} usable frames, got {len(usable)} ({why})")
    return usable, left_out


class _Session:
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
        if len(kept) < _LEAST_FRAMES:
            raise InputError(f"session: {text}, which leaves {len(kept)} frames; expected at least {_LEAST_FRAMES}")

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
            stacked = _stacked(self.views)
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
        agree = solution.misfit < session.largest_misfit * dimension
        covariance = deviations(self.model, _stacked(self.views), solution)
        reached = self.model.base_from_root(solution.calibration.offsets)
        reasons = dict(self._moved)
        tasks = []
        for i, (frame, view) in enumerate(zip(self.frames, self.views, strict=True)):
            doubts = self._slips(i)
            if not agree[i]:
                worst = np.sqrt(solution.misfit[i] / dimension)
                text = f"disagrees with the session: {worst:.1f} times the expected error from what it expects"
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
