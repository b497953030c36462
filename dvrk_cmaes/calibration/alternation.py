"""Alternating estimation of a session's calibration and of its frames' poses.

`Alternation.initialise` finds the camera_from_base that most frames' modes agree on, and faults of the session as a
whole. `Alternation.iterate` then alternates: each frame is fitted to its outline with the session's prediction as a
prior, and the calibration is estimated from all fits. `Alternation.report` makes each frame's result and leave-one-out
prediction.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.cable_estimate import CableEstimate
from dvrk_cmaes.calibration.consensus import Consensus, Mode, choose_modes, find_consensus
from dvrk_cmaes.calibration.constants import few_of
from dvrk_cmaes.calibration.faults import check_arm, check_motion, find_move
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.frame_reports import (
    check_agreement,
    describe_disagreements,
    report_tasks,
    with_readings,
)
from dvrk_cmaes.calibration.frame_task import (
    FitTask,
    FrameReport,
    Run,
    SessionFrame,
    fit_task,
    gather_task,
    report_task,
    with_changed_cameras,
    with_changed_views,
)
from dvrk_cmaes.calibration.imaging import Estimated, FittedSession, Imaging
from dvrk_cmaes.calibration.lag_estimate import LagEstimate
from dvrk_cmaes.calibration.lasting_errors import CommonErrors
from dvrk_cmaes.calibration.lasting_estimate import estimate_lasting
from dvrk_cmaes.calibration.masks_again import MasksAgain, PackedMask, with_masks
from dvrk_cmaes.calibration.model import Calibration, Deviations, SessionModel, offset_deviations, outer_readings
from dvrk_cmaes.calibration.session_camera import SessionCamera, covariance_of_camera, untold
from dvrk_cmaes.calibration.session_masks import SessionMasks
from dvrk_cmaes.calibration.session_rig import ViewRotation
from dvrk_cmaes.calibration.solve import FrameFits, leave_one_out, solution_at, solve, solve_with_modes
from dvrk_cmaes.calibration.starts import first_starts, next_starts
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.calibration.variances import solve_with_variances
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.terms.expected import Expected

Float64 = NDArray[np.float64]

LEAST_FRAMES = 3
"""Smallest number of frames from which a session can be calibrated."""

_ROLLED_ITERATIONS = 2  # first iterations, in which frames also start from poses rotated about the shaft
_NEAR = 1.0  # standard deviations per parameter, by which fits move to where the last solution expects them


class Alternation:
    """State of the alternating estimation.

    ``frames`` are the frames in use, ``stored`` their evidence and ``model`` their model; ``solution`` is the current
    solution and ``fits`` are the frames' current fits. ``remarks`` are texts about faults of the session as a whole
    that are put right, ``undetermined`` about what it does not determine; ``lag`` is the estimate of the lag of the
    images behind the readings, ``camera`` the change of the camera that the frames fit, None where it is not
    determined; ``change`` the one that is used, and ``rig`` what the further views differ in from the file.
    ``again`` is what changed as masks were found again, None where they were not; ``masks_found_again`` are those that
    are used, by frame and view.
    ``of_camera`` (K, K) is the mean square of the solution's errors that errors of the camera cause.

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
    rig
        The rotations of the further views against the file that the frames' own results tell; those that are clear are
        taken out of the frames.
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
        rig: tuple[ViewRotation, ...] = (),
        refine_camera: bool = False,
    ) -> None:
        self.frames = frames
        self._instrument = instrument
        self._arm: Arm = arm
        self._config = config
        self.run, self.progress = run, progress
        self._imaging = Imaging(np.zeros(3) if refine_camera else None, rig)
        self.of_camera: Float64
        self.fits: list[FrameFit] = []
        self.remarks: list[str] = []
        self.camera: SessionCamera | None = None
        self.undetermined: list[str] = []
        self.again: MasksAgain | None = None
        self.masks_found_again: dict[str, Mapping[str, PackedMask]] = {}
        self._first: dict[int, StoredFrame] = {}  # evidence of the first masks of frames whose masks were found again
        self._left_out: dict[str, str] = {}
        names, readings = instrument.joint_names, [frame.result.readings for frame in frames]
        joints = np.array([[of_frame.get(name, np.nan) for name in names] for of_frame in readings])
        deviations, outer = Deviations.of(config.session, names), outer_readings(readings)
        self.model = SessionModel(outer, joints, names, deviations, arm=arm, roll_offset=instrument.roll_offset)
        self._offset_std = offset_deviations(config, names)
        self._prior = np.diag([*np.zeros(6), *(1 / self._offset_std**2)])
        self._modes = [Mode.all_of(frame.result, names) for frame in frames]
        self._of_cables = names, deviations, self._offset_std[1:]
        self.cables = CableEstimate(*self._of_cables)
        self.lag = LagEstimate(series, [frame.name for frame in frames], deviations.outer)
        self._given = self.frames, self._modes, self.model, self._imaging
        self._gathered: dict[str, StoredFrame] = {}

    def initialise(self, lag: float | None = None) -> None:
        """Find the camera_from_base that most frames agree on, each frame's mode for it, and faults of the session.

        ``lag`` is taken out of the readings, in the unit of their times; by default that is done with the one on which
        the frames' own modes agree.

        Raises
        ------
        InputError
            The arm does not move, the readings only fit another arm or tool, or too few frames remain; or the camera is
            to be refined, and the session does not determine it.
        """
        check_motion(self.model)
        if self.change is not None and (reason := untold(self.model)):
            raise InputError(f"--refine-camera: {reason}")
        if lag is None:
            self.search_lag()
        else:
            self.lag.take(lag)
        self._take_out_lag()
        start = self._consensus_on_one_base().calibration
        self.solution, self._chosen = solve_with_modes(self.model, self._modes, start, self._prior)

    def search_lag(self) -> None:
        """Find the lag from the frames' own modes, without correcting the readings."""
        self.lag.search(self.model, self._modes, self._offset_std, self._prior)

    def at_lag(self, lag: float) -> Alternation:
        """Solve the same frames from the beginning with readings less another lag; as `initialise` and `iterate`."""
        other = copy.copy(self)
        other.frames, other._modes, other.model, other._imaging = self._given
        other.lag, other.cables = self.lag.of_all(), CableEstimate(*self._of_cables)
        other.fits, other.remarks, other.undetermined, other._left_out = [], [], [], {}
        other.initialise(lag)
        other.iterate()
        return other

    def tell_lag(self) -> float | None:
        """Determine the lag from the frames' fits where the modes did not; returns one that is to be tried, or None.

        Where the fits tell that there is none, what is not known of the lag does not widen the solution any more.
        """
        fits = self._frame_fits(keep_all=False)
        to_try = self.lag.tell_by_fits(self.model, fits, self.solution.calibration, self._prior)
        if self.lag.lag is not None:
            self._finish(self._frame_fits(keep_all=False))
        return to_try

    def _take_out_lag(self) -> None:
        """Correct the readings by the lag if it differs from zero."""
        applied = self.lag.applied
        if applied is None:
            return
        self._keep(np.flatnonzero(self.lag.has_readings()).tolist(), "no readings once the lag is taken out")
        if len(self.frames) < LEAST_FRAMES:
            raise InputError(
                f"session: {applied.describe()}, which leaves {len(self.frames)} frames with readings; "
                f"expected at least {LEAST_FRAMES}"
            )
        self.model = self.lag.corrected(self.model)

    def _consensus_on_one_base(self) -> Consensus:
        """Return the consensus of the frames, of which those before or after a move of the base are left out."""
        consensus = find_consensus(self.model, self._modes, self._offset_std)
        check_arm(self.model, self._modes, self._offset_std, consensus)
        move = find_move(self.model, self._modes, self._offset_std, consensus)
        if move is None:
            return consensus
        before, after = (self.frames[i].name for i in move.between)
        text = f"the arm's base or the camera moved between frames {before} and {after}"
        self.remarks.append(f"{text}: calibrated for the {move.side} of them")
        self._keep([i for i in range(len(self.frames)) if i not in move.others], text)
        return find_consensus(self.model, self._modes, self._offset_std)

    def _keep(self, kept: Sequence[int], reason: str) -> None:
        """Keep only the frames at some indices, and leave out the others for a reason."""
        names = {self.frames[i].name for i in kept}
        self._left_out |= {frame.name: reason for frame in self.frames if frame.name not in names}
        self.frames = [self.frames[i] for i in kept]
        self._modes = [self._modes[i] for i in kept]
        self.model = self.model.subset(kept)
        self.lag.select(kept)

    def iterate(self) -> None:
        """Gather each frame's evidence, then alternate between fitting all frames and estimating the calibration.

        The standard deviations of the predictions are multiplied by a factor that decreases to 1 over the iterations.
        """
        session = self._config.session
        self.progress("gathering evidence", len(self.frames))
        missing = [frame for frame in self.frames if frame.name not in self._gathered]
        self._gathered |= {
            frame.name: stored for frame, stored in zip(missing, self.run(gather_task, missing), strict=True)
        }
        self.stored = [self._gathered[frame.name] for frame in self.frames]
        scales = [*np.geomspace(session.loosened, 1.0, max(session.rounds - 1, 1)).tolist(), 1.0][: session.rounds]
        if self.change is not None:
            scales.append(1.0)  # with the camera that all rounds before have found
        begun = self._begin_with_few(scales)
        calibration, moved = self.solution.calibration, None
        for iteration in range(begun, len(scales)):
            fits = self._round(iteration, scales, calibration, moved)
            calibration = self.solution.calibration
            at, moved = fits.at, None
            if self.change is not None and iteration + 1 < len(scales):
                calibration, moved = self._use(self._fitted.with_camera(calibration, at))
            if iteration + 2 == len(scales):
                at = at if moved is None else moved
                calibration, changed = self._change_rig(calibration, at)
                moved = moved if changed is None else changed
                if self.change is None:
                    at = at if moved is None else moved
                    calibration, changed = self._use(self._fitted.with_margins(calibration, at))
                    moved = moved if changed is None else changed
        self._finish(fits)

    def _round(
        self, iteration: int, scales: Sequence[float], calibration: Calibration, moved: Posed | None
    ) -> FrameFits:
        """Fit the frames to what the calibration predicts, and estimate the calibration from the fits, returned.

        ``scales`` are the factors on the standard deviations of the predictions, one of each round; ``moved`` is as in
        `_starts`.
        """
        scale, last = scales[iteration], iteration + 1 == len(scales)
        self.progress(f"round {iteration + 1} of {len(scales)}", len(self.frames))
        expected = self.model.priors(calibration, scale=scale)
        self._fit(expected, self._starts(iteration, expected, moved, last=last), last=last)
        # Fits that do not explain the mask are only excluded once the prior is no longer widened.
        return self._solve_round(calibration, keep_all=scale != 1.0)

    def _begin_with_few(self, scales: Sequence[float]) -> int:
        """Do the rounds whose predictions are widened with few of many frames; returns the number of these rounds.

        They only serve to find the calibration from which all frames are then fitted. With another camera than the
        file's, the frames' own modes are no starts after them, so all frames take part in all rounds.

        Parameters
        ----------
        scales
            The factors on the standard deviations of the predictions, one of each round.
        """
        index = few_of(len(self.frames)) if self.change is None else None
        rounds = sum(scale != 1.0 for scale in scales[:-1])  # all frames take part in the last one in any case
        if index is None or rounds == 0:
            return 0
        few = self._of_few(index.tolist())
        for iteration in range(rounds):
            few._round(iteration, scales, few.solution.calibration, None)
        self.lag.take_from(few.lag)
        self.model = self.lag.corrected(self.model.with_deviations(few.model.deviations))
        calibration = few.solution.calibration
        self._chosen = choose_modes(self.model, self._modes, calibration)
        self.solution = solution_at(self.model, FrameFits.of_modes(self._chosen), calibration, self._prior)
        return rounds

    def _of_few(self, index: Sequence[int]) -> Alternation:
        """Return the state of the frames at some indices, before their first fit."""
        few = copy.copy(self)
        few.lag, few.model = copy.copy(self.lag), self.model.subset(index)
        few.lag.select(index)
        few.frames, few.stored = [self.frames[i] for i in index], [self.stored[i] for i in index]
        few._modes, few._chosen = [self._modes[i] for i in index], [self._chosen[i] for i in index]
        modes = FrameFits.of_modes(few._chosen)
        few.solution = solution_at(few.model, modes, self.solution.calibration, self._prior)
        return few

    def _solve_round(self, calibration: Calibration, *, keep_all: bool) -> FrameFits:
        """Estimate the calibration, the cables and the lag from the current fits, which are returned.

        ``keep_all`` is whether fits that do not explain the mask count as well. `InputError` if too few do.
        """
        if not keep_all:
            texts = ["" if fit.explains_mask else fit.describe_overlap() for fit in self.fits]
            check_agreement(self.frames, texts, LEAST_FRAMES)
        fits = self._frame_fits(keep_all=keep_all)
        self._solve(fits, calibration)
        if not keep_all and self._config.session.cables:
            self._correct_cables(fits)
        self.lag.refine(self.model, fits, self.solution.calibration, self._prior)
        self.model = self.lag.corrected(self.model)
        return fits

    def _frame_fits(self, *, keep_all: bool) -> FrameFits:
        """Return the current fits; without the outlines that do not explain the mask, unless they are kept as well."""
        fits = [fit if fit.explains_mask or keep_all else fit.without_outline() for fit in self.fits]
        terms = [fit.whole_outline for fit in fits]
        return FrameFits.with_lasting(Posed.stacked(fit.at for fit in fits), terms, self._common)

    def _finish(self, fits: FrameFits) -> None:
        """Solve once more with all that was found from the fits of the last round, and the size of lasting errors."""
        self.solution = solve(self.model, fits, self.solution.calibration, self._prior)
        lasting = estimate_lasting(self.model, self.fits, self.solution, self._prior, self._times)
        self._imaging = replace(self._imaging, lasting=lasting)
        self.fits = [fit.with_size(lasting.size) for fit in self.fits]
        fits = self._frame_fits(keep_all=False)
        self.solution = solve(self.model, fits, self.solution.calibration, self._prior)
        expected = self.model.priors(self.solution.calibration)
        pairs = zip(self.fits, expected, strict=True)
        self.fits = [fit.moved_to(own) if fit.step_to(own) < _NEAR else fit for fit, own in pairs]
        self.lag.estimate_joints(self.model, fits, self.solution.calibration, self._prior)

    def with_masks(self, masks: Mapping[int, Mapping[str, PackedMask]]) -> Alternation:
        """Return a copy with other masks of some frames, solved in one more round from the current solution."""
        other = copy.copy(self)
        other.lag, other.cables = copy.copy(self.lag), copy.copy(self.cables)
        other.remarks, other.undetermined = list(self.remarks), list(self.undetermined)
        other.frames = [
            replace(frame, data=with_masks(frame.data, masks[i])) if i in masks else frame
            for i, frame in enumerate(self.frames)
        ]
        other._first = {i: self.stored[i] for i in masks}
        other.masks_found_again = {self.frames[i].name: of_frame for i, of_frame in masks.items()}
        other.stored = list(self.stored)
        other.progress("solving again", len(masks))
        for i, stored in zip(masks, other.run(gather_task, [other.frames[i] for i in masks]), strict=True):
            other.stored[i] = stored
        expected = other.model.priors(other.solution.calibration)
        starts = [(fit.at,) if i in masks else () for i, fit in enumerate(other.fits)]
        other._fit(expected, starts, last=True)
        other._finish(other._solve_round(other.solution.calibration, keep_all=False))
        return other

    @property
    def agreeing(self) -> list[bool]:
        """Whether each frame agrees with the session."""
        return [not text for text in describe_disagreements(self.fits, self.solution, self._config.session)]

    def left_out_predictions(self) -> list[Posed]:
        """Return what all other frames predict of each frame."""
        return [self.model.subset([i]).predict(leave_one_out(self.solution, i))[0] for i in range(len(self.frames))]

    def _starts(
        self, iteration: int, expected: Sequence[Expected], moved: Posed | None, *, last: bool
    ) -> list[tuple[Posed, ...]]:
        """Return the starts of each frame in an iteration, none where its fit is settled; ``moved`` by a new camera."""
        angle = float(np.deg2rad(self._config.session.turn_deg))
        misfit = self.solution.misfit / (6 + len(self.model.names))
        if not self.fits:
            pairs = zip(self._modes, self._chosen, misfit, expected, strict=True)
            return [first_starts(*of_frame, angle) for of_frame in pairs]
        turn = angle if iteration < _ROLLED_ITERATIONS else None
        return [
            next_starts(
                fit,
                float(misfit[i]) if fit.explains_mask else np.inf,
                expected[i],
                turn,
                last=last,
                changed=None if moved is None else moved[i],
            )
            for i, fit in enumerate(self.fits)
        ]

    def _fit(self, expected: Sequence[Expected], starts: Sequence[tuple[Posed, ...]], *, last: bool) -> None:
        """Fit the frames that have starts, with what the session expects of each as its prior.

        The others keep the linearisation of their outline, whose minimum is their fit in the ``last`` round.
        """
        again = [i for i, of_frame in enumerate(starts) if of_frame]
        tasks = [
            FitTask(self.stored[i], expected[i], starts[i], self.change, self._imaging.margins_of(self.stored[i]))
            for i in again
        ]
        fits = dict(enumerate(self.fits))
        if last:
            fits = {i: fit.moved_to(expected[i]) for i, fit in fits.items()}
        fits |= zip(again, self.run(fit_task, tasks), strict=True)
        self.fits = [fits[i] for i in range(len(self.frames))]

    def _solve(self, fits: FrameFits, start: Calibration) -> None:
        """Estimate the calibration together with the variances."""
        session = self._config.session
        initial = self.cables.deviations(Deviations.of(session, self.model.names))
        self.model, self.solution = solve_with_variances(self.model, fits, start, self._prior, session, initial)

    def _correct_cables(self, fits: FrameFits) -> None:
        """Estimate the cables, and solve again with the corrected readings."""
        self.model = self.cables.corrected(self.model, fits, self.solution, self.lag)
        initial = self.cables.deviations(self.model.deviations)
        if initial is not None:
            self.model = self.model.with_deviations(initial)
            self._solve(fits, self.solution.calibration)

    def _use(self, estimated: Estimated) -> tuple[Calibration, Posed | None]:
        """Use cameras and masks that were estimated; returns the calibration and the moved poses, if any, with them."""
        self._imaging = estimated.imaging
        self.undetermined += estimated.undetermined
        return estimated.calibration, estimated.at

    def _change_rig(self, calibration: Calibration, at: Posed) -> tuple[Calibration, Posed | None]:
        """Estimate what the further views differ in from the file beside rotations, and use what is clear.

        Returns the calibration, and the frames' poses with the changed views; None if none is changed.
        """
        fitted = self._fitted
        outlines = fitted.rig_outlines
        if outlines is None:
            return calibration, None
        self.progress("checking the rig", len(self.frames))
        try:
            estimated = fitted.with_rig(calibration, at, outlines)
        except InputError as error:
            self.undetermined.append(f"rig: {error}")
            return calibration, None
        if estimated.changes is not None:
            self.frames = [
                with_changed_views(
                    frame, estimated.changes, {view.name: view.view_from_camera for view in stored.views}
                )
                for frame, stored in zip(self.frames, self.stored, strict=True)
            ]
            self.progress("gathering evidence", len(self.frames))
            self.stored = self.run(gather_task, self.frames)
        return self._use(estimated)

    @property
    def _fitted(self) -> FittedSession:
        """The frames with their current fits, from which cameras and masks are estimated."""
        return FittedSession(
            self.model,
            self._prior,
            self._config.session,
            self.fits,
            self.stored,
            self._common,
            self.run,
            self._imaging,
        )

    @property
    def _times(self) -> Float64:
        """Times (N,) of the frames, s; NaN where unknown."""
        read = self.lag.seconds()
        return np.full(len(self.frames), np.nan) if read is None else read

    @property
    def _common(self) -> CommonErrors:
        """The errors that the frames share."""
        by_lag = self.lag.change_of_predictions(self.model, self.solution.calibration)
        return CommonErrors(self._imaging.size, self._times, by_lag, self._config.session.alike_seconds)

    @property
    def masks(self) -> SessionMasks | None:
        """What is stated of errors that the masks share; None if their margin was not estimated."""
        return self._imaging.masks

    @property
    def rig(self) -> tuple[ViewRotation, ...]:
        """What the further views differ in from the file."""
        return self._imaging.rig

    @property
    def change(self) -> Float64 | None:
        """Change (3,) of the camera that is used; None if that of its file is."""
        return self._imaging.change

    def check_constants(self) -> None:
        """Test whether the frames contradict the camera file."""
        solution, session = self.solution, self._config.session
        if self.lag.applied is not None:
            self.remarks.append(
                f"{self.lag.applied.describe()}: taken out; other commands take it out with {self.lag.applied.option}"
            )
        self.progress("checking the camera", len(self.frames))
        check = self._fitted.check_camera(solution.calibration)
        self.of_camera, self.camera = check.covariance, check.camera
        if check.camera is None:
            self.undetermined.append(check.undetermined)
        elif check.camera.applied:
            self.remarks += check.camera.contradictions(session)
        if self.change is not None:
            self.stored = self.run(gather_task, [with_changed_cameras(frame, self.change) for frame in self.frames])

    @property
    def camera_remarks(self) -> tuple[str, ...]:
        """What is unusual about the camera files of the first frame."""
        first = self.stored[0]
        further = [view for view in first.views if not np.array_equal(view.view_from_camera, np.eye(4))]
        of_views = (f"view {view.name}: {text}" for view in further for text in view.stored.evidence.camera.remarks)
        return (*first.camera.remarks, *of_views)

    @property
    def evidence(self) -> dict[str, Evidence]:
        """Evidence of the first view of each frame in use by its name, without the images."""
        return {frame.name: stored.reference.evidence for frame, stored in zip(self.frames, self.stored, strict=True)}

    def report(self) -> tuple[list[FrameReport], dict[str, str]]:
        """Return the reports of the frames in use, and by name the reason for each frame that is left out.

        Raises
        ------
        InputError
            Too few frames agree with the calibration.
        """
        self.progress("leaving one out", len(self.frames))
        session, model, solution = self._config.session, self.model, self.solution
        disagreements = describe_disagreements(self.fits, solution, session)
        check_agreement(self.frames, disagreements, LEAST_FRAMES)
        named = zip(self.frames, disagreements, strict=True)
        reasons = self._left_out | {frame.name: text for frame, text in named if text}
        frames = self.frames if self.lag.applied is None else with_readings(self.frames, model)
        stated = {**self._config.as_dict(), "instrument": self._instrument.describe_limits(self._arm)}
        tasks = report_tasks(frames, self.stored, self.fits, model, solution, disagreements, session, stated)
        tasks = [replace(task, first=self._first.get(i), change=self.change) for i, task in enumerate(tasks)]
        of_camera = [
            covariance_of_camera(self.camera, fit.at, stored.camera)
            for fit, stored in zip(self.fits, self.stored, strict=True)
        ]
        pairs = zip(tasks, of_camera, strict=True)
        tasks = [replace(task, covariance=task.covariance + own) for task, own in pairs]
        return self.run(report_task, tasks), reasons
