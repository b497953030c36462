"""Alternating estimation of a session's calibration and of its frames' poses.

`Alternation.initialise` finds the camera_from_base that most frames' modes agree on, and faults of the session as a
whole. `Alternation.iterate` then alternates: each frame is fitted to its outline with the session's prediction as a
prior, and the calibration is estimated from all fits. `Alternation.report` makes each frame's result and leave-one-out
prediction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.cable_estimate import CableEstimate
from dvrk_cmaes.calibration.camera_change import SessionOutlines, changed, estimate_camera
from dvrk_cmaes.calibration.consensus import Mode, choose_modes, find_consensus
from dvrk_cmaes.calibration.faults import check_arm, check_motion, find_move
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.frame_task import (
    DataOfCamera,
    FitTask,
    FrameReport,
    ReportTask,
    Run,
    SessionFrame,
    fit_task,
    gather_task,
    report_task,
)
from dvrk_cmaes.calibration.lag_estimate import LagEstimate
from dvrk_cmaes.calibration.model import Calibration, Deviations, SessionModel, outer_readings
from dvrk_cmaes.calibration.offset_check import describe_far_offsets
from dvrk_cmaes.calibration.session_camera import SessionCamera, check_camera, untested
from dvrk_cmaes.calibration.solve import FrameFits, frame_covariances, leave_one_out, solve
from dvrk_cmaes.calibration.starts import first_starts, next_starts
from dvrk_cmaes.calibration.variances import estimate_variances
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import Posed, inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.results.result import Result

Float64 = NDArray[np.float64]

LEAST_FRAMES = 3
"""Smallest number of frames from which a session can be calibrated."""

_MODE_ITERATIONS = 5  # largest number of alternations between choosing the frames' modes and solving
_EM_ITERATIONS = 3  # estimates of calibration and variance components between two fits of the frames
_ROLLED_ITERATIONS = 2  # first iterations, in which frames also start from poses rotated about the shaft
_SLIP = 4.0  # standard deviations beyond which a joint's reading is reported
_LEAST_OVERLAP = 0.5  # intersection over union below which a fit is not used
_TRUSTED_SHARE = 0.5  # of the frames; if fewer agree, there is a warning
_CAMERA_PASSES = 2  # linearisations of the outlines about the camera between two fits of the frames
_OVERLAP_LOSS = 0.1  # by which the fit's intersection over union may fall below that of the frame's own estimate


class Alternation:
    """State of the alternating estimation.

    ``frames`` are the frames in use and ``model`` their model; ``solution`` is the current solution and ``fits`` are
    the frames' current fits. ``warnings`` are texts about faults of the session as a whole, ``untold`` about what it
    does not determine; ``lag`` is the estimate of the lag of the images behind the readings, ``camera`` the change of
    the camera that the frames fit, None where it is not determined. ``of_camera`` (K, K) is the mean square of the
    solution's errors that errors of the camera cause.

    Parameters
    ----------
    frames
        Frames with a pose, its covariance and readings of all outer joints, in the order they were taken.
    series
        Readings as functions of time, with the frames' times; None if the lag is not to be estimated.
    instrument, arm, config
        The instrument, the kinematics of the outer arm and all settings.
    run
        Applies a function to many tasks.
    progress
        Called before each stage with its name and the number of frames.
    refine_camera
        Whether the change of the camera that the frames fit is used.
    """

    def __init__(
        self,
        frames: list[SessionFrame],
        series: ReadingSeries | None,
        instrument: Instrument,
        arm: Arm,
        config: EstimateConfig,
        run: Run[Any, Any],
        progress: Callable[[str, int], None],
        *,
        refine_camera: bool = False,
    ) -> None:
        self.frames = frames
        self._instrument = instrument
        self._arm: Arm = arm
        self._config = config
        self._run = run
        self._progress = progress
        self._refine_camera = refine_camera
        self._change = np.zeros(3)
        self.of_camera: Float64
        self.fits: list[FrameFit] = []
        self.warnings: list[str] = []
        self.camera: SessionCamera | None = None
        self.untold: list[str] = []
        self._left_out: dict[str, str] = {}
        names = instrument.joint_names
        joints = np.array([[f.result.readings.get(name, np.nan) for name in names] for f in frames])
        deviations = Deviations.of(config.session, names)
        outer = outer_readings([f.result.readings for f in frames])
        self.model = SessionModel(outer, joints, names, deviations, arm=arm, roll_offset=instrument.roll_offset)
        session = config.session
        angles = np.deg2rad([session.roll_offset_deg, *(config.readings.of(name) for name in names)])
        self._offset_std = np.array([session.insertion_offset_mm * 1e-3, *angles])
        self._prior = np.zeros((8 + len(names),) * 2)
        self._prior[6:, 6:] = np.diag(1 / self._offset_std**2)
        self._modes = [self._modes_of(frame.result) for frame in frames]
        self.cables = CableEstimate(names, deviations, self._offset_std[1:])
        self.lag = LagEstimate(series, [frame.name for frame in frames], deviations.outer)

    def _joints(self, joints: dict[str, float]) -> Float64:
        """Return joints by name as an array (J,) in the instrument's order."""
        return np.array([joints[name] for name in self._instrument.joint_names])

    def _modes_of(self, result: Result) -> list[Mode]:
        """Return the modes of a frame's own result: its pose and its alternatives, all with the pose's covariance."""
        assert result.camera_from_root is not None
        assert result.covariance is not None
        first = Mode(result.camera_from_root, self._joints(result.joints), result.covariance)
        others = [Mode(a.camera_from_root, self._joints(a.joints), result.covariance) for a in result.alternatives]
        return [first, *others]

    def initialise(self) -> None:
        """Find the camera_from_base that most frames agree on, each frame's mode for it, and faults of the session.

        Raises
        ------
        InputError
            The arm does not move, the readings only fit another arm or tool, or too few frames remain; or the camera is
            to be refined, and the session does not determine it.
        """
        check_motion(self.model)
        if self._refine_camera and (reason := untested(self.model)):
            raise InputError(f"--refine-camera: {reason}")
        self._initialise_lag()
        consensus = find_consensus(self.model, self._modes, self._offset_std)
        check_arm(self.model, self._modes, self._offset_std, consensus)
        move = find_move(self.model, self._modes, self._offset_std, consensus)
        if move is not None:
            before, after = (self.frames[i].name for i in move.between)
            text = f"the arm's base or the camera moved between frames {before} and {after}"
            self.warnings.append(f"{text}: calibrated for the {move.side} of them")
            self._left_out |= {self.frames[i].name: text for i in move.others}
            self._select([i for i, frame in enumerate(self.frames) if frame.name not in self._left_out])
            consensus = find_consensus(self.model, self._modes, self._offset_std)
        calibration = consensus.calibration
        self._chosen = choose_modes(self.model, self._modes, calibration)
        for _ in range(_MODE_ITERATIONS):
            self.solution = solve(self.model, FrameFits.of_modes(self._chosen), calibration, self._prior)
            calibration, previous = self.solution.calibration, self._chosen
            self._chosen = choose_modes(self.model, self._modes, calibration)
            if all(a is b for a, b in zip(self._chosen, previous, strict=True)):
                break

    def search_lag(self) -> None:
        """Find the lag from the frames' own modes, without correcting the readings."""
        self.lag.search(self.model, self._modes, self._offset_std, self._prior)

    def _initialise_lag(self) -> None:
        """Find the lag from the frames' own modes, and correct the readings if it differs from zero."""
        self.search_lag()
        applied = self.lag.applied
        if applied is None:
            return
        kept = self.lag.has_readings()
        self._left_out |= {
            frame.name: "no readings once the lag is taken out"
            for frame, has_readings in zip(self.frames, kept, strict=True)
            if not has_readings
        }
        self._select(np.flatnonzero(kept).tolist())
        if len(self.frames) < LEAST_FRAMES:
            raise InputError(
                f"session: {applied.describe()}, which leaves {len(self.frames)} frames with readings; "
                f"expected at least {LEAST_FRAMES}"
            )
        self._correct_lag()

    def _correct_lag(self) -> None:
        """Give each frame the readings of the time of its image less the lag that is taken out, if there is one."""
        if self.lag.applied is None:
            return
        self.model = self.lag.corrected(self.model)
        for i, frame in enumerate(self.frames):
            names = (*OUTER_JOINTS, *self._instrument.joint_names)
            values = (*self.model.outer[i], *self.model.joints[i])
            readings = {n: float(v) for n, v in zip(names, values, strict=True) if not np.isnan(v)}
            self.frames[i] = replace(frame, result=replace(frame.result, readings=readings))

    def _select(self, kept: list[int]) -> None:
        """Keep only the frames at some indices."""
        self.frames = [self.frames[i] for i in kept]
        self._modes = [self._modes[i] for i in kept]
        self.model = self.model.subset(kept)
        self.lag.select(kept)

    def iterate(self) -> None:
        """Gather each frame's evidence, then alternate between fitting all frames and estimating the calibration.

        The standard deviations of the predictions are multiplied by a factor that decreases to 1 over the iterations.
        """
        session = self._config.session
        self._progress("gathering evidence", len(self.frames))
        self._stored = self._run(gather_task, self.frames)
        if self._refine_camera and any(len(stored.views) > 1 for stored in self._stored):
            raise InputError("--refine-camera: expected frames of one camera, got those of a stereo pair")
        scales = [*np.geomspace(session.loosened, 1.0, max(session.rounds - 1, 1)).tolist(), 1.0][: session.rounds]
        if self._refine_camera:
            scales.append(1.0)  # with the camera that all rounds before have found
        calibration = self.solution.calibration
        moved: Sequence[Posed | None] = [None] * len(self.frames)
        for iteration, scale in enumerate(scales):
            self._progress(f"round {iteration + 1} of {len(scales)}", len(self.frames))
            expected = self.model.priors(calibration, scale=scale)
            last = iteration + 1 == len(scales)
            self._fit(expected, self._starts(iteration, expected, moved, last=last), last=last)
            # Fits that do not explain the mask are only excluded once the prior is no longer widened.
            keep_all = scale != 1.0
            stacked = _stacked([fit if _explains(fit) or keep_all else fit.without_outline() for fit in self.fits])
            calibration = self._solve(stacked, calibration)
            if scale == 1.0 and session.cables:
                calibration = self._correct_cables(stacked, calibration)
            self.lag.refine(self.model, stacked, calibration, self._prior)
            self._correct_lag()
            if self._refine_camera and iteration + 1 < len(scales):
                calibration, moved = self._change_camera(calibration, stacked)
        self.solution = solve(self.model, stacked, calibration, self._prior)
        self.lag.estimate_joints(self.model, stacked, self.solution.calibration, self._prior)
        if self.lag.applied is not None:
            self.warnings.append(
                f"{self.lag.applied.describe()}: taken out; other commands take it out with {self.lag.applied.option}"
            )

    def _starts(
        self, iteration: int, expected: Sequence[Expected], moved: Sequence[Posed | None], *, last: bool
    ) -> list[tuple[Posed, ...]]:
        """Return the starts of each frame in an iteration, none where its fit is settled; ``moved`` by a new camera."""
        angle = float(np.deg2rad(self._config.session.turn_deg))
        misfit = self.solution.misfit / (6 + len(self.model.names))
        if iteration == 0:
            pairs = zip(self._modes, self._chosen, misfit, expected, strict=True)
            return [first_starts(*of_frame, angle) for of_frame in pairs]
        turn = angle if iteration < _ROLLED_ITERATIONS else None
        misfit = np.where([_explains(fit) for fit in self.fits], misfit, np.inf)
        frames = zip(self.fits, misfit, expected, moved, strict=True)
        return [next_starts(fit, off, prior, turn, last=last, changed=to) for fit, off, prior, to in frames]

    def _fit(self, expected: Sequence[Expected], starts: Sequence[tuple[Posed, ...]], *, last: bool) -> None:
        """Fit the frames that have starts, with what the session expects of each as its prior.

        The others keep the linearisation of their outline, whose minimum is their fit in the ``last`` round.
        """
        left = [i for i, of_frame in enumerate(starts) if of_frame]
        tasks = [
            FitTask(
                self._stored[i],
                self.frames[i].result.readings,
                expected[i],
                starts[i],
                self._changed_camera(i) if self._refine_camera else None,
            )
            for i in left
        ]
        again: dict[int, FrameFit] = dict(zip(left, self._run(fit_task, tasks), strict=True))
        kept = {i: self.fits[i].moved_to(expected[i]) if last else self.fits[i] for i, s in enumerate(starts) if not s}
        self.fits = [again[i] if i in again else kept[i] for i in range(len(self.frames))]

    def _solve(self, fits: FrameFits, calibration: Calibration) -> Calibration:
        """Alternate between estimating the calibration and the variances, from a calibration to start with."""
        session = self._config.session
        initial = self.cables.deviations(Deviations.of(session, self.model.names))
        for _ in range(_EM_ITERATIONS):
            self.solution = solve(self.model, fits, calibration, self._prior)
            calibration, weights = self.solution.calibration, self.solution.weights
            self.model = estimate_variances(self.model, fits, calibration, weights, session, initial)
        return calibration

    def _correct_cables(self, fits: FrameFits, calibration: Calibration) -> Calibration:
        """Estimate the cables, and solve again with the corrected readings, from a calibration to start with."""
        self.model = self.cables.corrected(self.model, fits, self.solution, self.lag)
        initial = self.cables.deviations(self.model.deviations)
        if initial is None:
            return calibration
        self.model = self.model.with_deviations(initial)
        return self._solve(fits, calibration)

    def check_constants(self) -> None:
        """Test whether the frames contradict the camera file, and whether the offsets are far outside their priors."""
        solution, session = self.solution, self._config.session
        self._progress("checking camera and offsets", len(self.frames))
        applied = self._change if self._refine_camera else None
        fits, outlines = _stacked(self.fits), self._outlines()
        found = check_camera(self.model, solution.calibration, self._prior, session, fits, outlines, applied=applied)
        self.of_camera, self.camera = found.covariance, found.camera
        if found.camera is None:
            self.untold.append(found.untold)
        else:
            self.warnings += found.camera.warnings(session)
        self.warnings += describe_far_offsets(solution.calibration, solution.covariance, self.model, self._offset_std)
        if self._refine_camera:
            seen = [
                replace(one, data=DataOfCamera(one.data, self._changed_camera(i))) for i, one in enumerate(self.frames)
            ]
            self._stored = self._run(gather_task, seen)

    def _change_camera(self, calibration: Calibration, fits: FrameFits) -> tuple[Calibration, list[Posed]]:
        """Estimate the change of the camera from the current fits, and use it; as `estimate_camera`.

        Returns the calibration and each frame's pose and joints with the changed camera.
        """
        found = estimate_camera(
            self.model,
            calibration,
            self._prior,
            self._config.session,
            fits,
            self._outlines(),
            start=self._change,
            passes=_CAMERA_PASSES,
        )
        self._change = found.change
        return found.calibration, [Posed(*of_frame) for of_frame in zip(found.poses, found.joints, strict=True)]

    def _changed_camera(self, i: int) -> Camera:
        """Return the camera of a frame with the current change."""
        return changed(self._stored[i].camera, self._change)

    def _outlines(self) -> SessionOutlines:
        """Return the outlines of all frames, as functions of poses, joints and camera."""
        own = tuple(stored.own for stored in self._stored)
        readings = tuple(frame.result.readings for frame in self.frames)
        pairs = zip(self.fits, self._stored, strict=True)
        used = np.array([_explains(fit) and stored.in_reference for fit, stored in pairs])
        stored = tuple(one.reference for one in self._stored)
        return SessionOutlines(stored, readings, own, used, self._run)

    @property
    def evidence(self) -> dict[str, Evidence]:
        """Evidence of the first view of each frame in use by its name, without the images."""
        return {frame.name: stored.reference.evidence for frame, stored in zip(self.frames, self._stored, strict=True)}

    def report(self) -> tuple[list[FrameReport], dict[str, str]]:
        """Return the reports of the frames in use, and by name the reason for each frame that is left out.

        Raises
        ------
        InputError
            Too few frames agree with the calibration.
        """
        self._progress("leaving one out", len(self.frames))
        solution, session = self.solution, self._config.session
        dimension = 6 + len(self.model.names)
        near = solution.misfit < session.largest_misfit * dimension
        agree = near & np.array([_explains(fit) for fit in self.fits])
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
        covariance = frame_covariances(self.model, _stacked(self.fits), solution)
        base_from_root = self.model.base_from_root(solution.calibration.offsets)
        reasons = dict(self._left_out)
        tasks = []
        for i, (frame, fit) in enumerate(zip(self.frames, self.fits, strict=True)):
            doubts = self._describe_slips(i)
            if not agree[i]:
                deviation = np.sqrt(solution.misfit[i] / dimension)
                text = "disagrees with the session: "
                if near[i]:
                    text += (
                        f"what it expects does not explain the mask (IoU {fit.iou:.2f}, by itself {fit.own_iou:.2f})"
                    )
                else:
                    text += f"{deviation:.1f} times the expected error from what it expects"
                reasons[frame.name] = text
                doubts = [text, *doubts]
            one, without = self.model.subset([i]), leave_one_out(solution, i)
            poses, joints = one.predict(without)
            jacobian = one.jacobian(without)[0]
            spread = one.covariance(without)[0] + jacobian @ solution.covariance @ jacobian.T
            tasks.append(
                ReportTask(
                    self._stored[i],
                    frame.result,
                    fit,
                    covariance[i],
                    Posed(poses[0], joints[0]),
                    np.sqrt(np.diag(spread)[6:]),
                    np.asarray(fit.at.pose @ inverse(base_from_root[i])),
                    tuple(doubts),
                    bool(agree[i]),
                    config={**self._config.as_dict(), "instrument": self._instrument.describe_limits(self._arm)},
                )
            )
        return self._run(report_task, tasks), reasons

    def _describe_slips(self, i: int) -> list[str]:
        """Describe the joints whose readings have a large error in one frame, one text for each joint."""
        stds = [self.model.deviations.outer[3], *self.model.deviations.joints]
        found = []
        for name, factor, std in zip(("roll", *self.model.names), self.model.inflation[i], stds, strict=True):
            error = factor * self._config.session.tail  # in standard deviations
            if error > _SLIP:
                degrees = np.degrees(error * std)
                found.append(f"reading of {name}: {degrees:.0f} deg off in this frame, beyond the session's offset")
        return found


def _explains(fit: FrameFit) -> bool:
    """Return whether a fit with the session's prior overlaps the mask about as well as the frame's own estimate."""
    return fit.iou > max(fit.own_iou - _OVERLAP_LOSS, _LEAST_OVERLAP)


def _stacked(fits: Sequence[FrameFit]) -> FrameFits:
    """Stack the fits of single frames."""
    return FrameFits(
        np.array([fit.at.pose for fit in fits]),
        np.array([fit.at.joints for fit in fits]),
        np.array([fit.information for fit in fits]),
        np.array([fit.slope for fit in fits]),
    )
