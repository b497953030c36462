"""A session as one least-squares problem: the frames of its arms, and the blocks of unknowns that these share.

`initialised` finds by the frames' own modes the camera_from_base that most frames of each arm agree on, and faults of
the session as a whole. `solved` then alternates: each frame is fitted to its outline with what the blocks predict as a
prior, and the blocks of all arms are estimated from all fits. `checked` tests the cameras and the masks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration, SeenBlock
from dvrk_cmaes.calibration.cables import MARGIN, CableFit, estimate_cables
from dvrk_cmaes.calibration.consensus import (
    INLIER_MISFIT,
    Consensus,
    Mode,
    check_arm,
    check_motion,
    choose_modes,
    find_consensus_at_any_roll,
)
from dvrk_cmaes.calibration.endoscope_search import describe_pieces, find_pieces
from dvrk_cmaes.calibration.frame_fit import FrameFit, starts_of
from dvrk_cmaes.calibration.lag import NO_READINGS_AT_LAG, SessionLag
from dvrk_cmaes.calibration.linearise import ArmOutlines, linearise
from dvrk_cmaes.calibration.model import CommonErrors, Deviations, SessionModel, frames_alike
from dvrk_cmaes.calibration.session_camera import (
    CAMERA,
    IMPLAUSIBLE,
    CameraChange,
    CameraCheck,
    Lens,
    camera_undetermined,
    check_camera,
    file_deviations,
)
from dvrk_cmaes.calibration.session_frame import Run, SessionFrame, StoredFrame, fit_task, gather_task
from dvrk_cmaes.calibration.session_masks import (
    MaskMargin,
    SessionMasks,
    estimate_margin,
)
from dvrk_cmaes.calibration.session_rig import ViewRotation, turns_of
from dvrk_cmaes.calibration.session_shaft import InstrumentSizes
from dvrk_cmaes.calibration.solve import (
    ArmFrames,
    FrameFits,
    Solved,
    solve_arms,
    solve_with_modes,
)
from dvrk_cmaes.calibration.variances import solve_with_variances
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.doubts import DISAGREES, frame_disagrees

TESTED: Final[tuple[Callable[[EstimateConfig, Camera], SeenBlock], ...]] = (Lens,)
"""What makes the further blocks that every session is tested for, each of which states itself."""
LEAST_FRAMES = 3
"""Smallest number of frames from which an arm can be calibrated."""

_ROUNDS = 4  # in which frames and blocks are estimated in turn
_NEAR = 1.0  # standard deviations per parameter, by which fits move to where the last solution expects them
_CAMERA_PASSES = 2  # linearisations of the outlines about the camera between two fits of the frames
_MOST_NAMED = 4
_TO_TRY = "try another --instrument, --tool or --arm, other readings, or the lag of all rows of the recording"


@dataclass(frozen=True, eq=False)
class ArmSetup:
    """What an arm's session is estimated with, besides its frames.

    ``series`` are the readings as functions of time, with the frames' times; None if the lag is not to be estimated.
    ``instrument``, ``arm`` and ``config`` are the instrument, the kinematics of the outer arm and all settings. ``run``
    applies a function to many tasks, ``progress`` is called before each stage with its name and the number of frames.
    ``refine_camera`` is whether the change of the camera that the frames fit is used, ``guessed_camera`` whether the
    frames' camera is a guess, of which there is no file. ``may_cut`` is whether the session may be cut into pieces
    between which the base moved. ``lag`` is the one that is taken out of the readings, None to look for it.
    """

    series: ReadingSeries | None
    instrument: Instrument
    arm: Arm
    config: EstimateConfig
    run: Run[Any, Any]
    progress: Callable[[str, int], None] = lambda stage, count: None
    refine_camera: bool = False
    guessed_camera: bool = False
    may_cut: bool = True
    lag: Lag | None = None


@dataclass(frozen=True, eq=False)
class ArmSession:
    """The frames of one arm in a session, and how far its estimation is.

    ``frames`` are the N frames in use, ``modes`` those of each and ``model`` the model of their readings, with what the
    lag takes out of these; ``cables`` are the fits of what cables do to readings, None before the first. ``stored`` is
    the frames' evidence and ``fits`` are their current fits, both empty before the first round. ``found`` is the
    current solution, None before the first one; ``start`` and ``moved`` (N) are the calibration and the poses from
    which the next round starts, where a camera or a margin was estimated since.

    ``change`` (3,) is that of the camera, as of `session_frame.changed`, None where the camera's file is used, and
    ``camera_found`` whether its last estimate is plausible; ``rig`` what the further views differ in from the
    file; ``masks`` states the margin of the masks, ``check`` is the test of the camera, None until
    they are known.

    ``remarks`` are about faults of the session as a whole that are put right, ``undetermined`` about what it does not
    determine; ``left_out`` are the reasons for which frames are left out, by name.
    """

    setup: ArmSetup
    frames: tuple[SessionFrame, ...]
    modes: tuple[Sequence[Mode], ...]
    model: SessionModel
    lag: SessionLag
    rig: tuple[ViewRotation, ...] = ()
    change: Float64 | None = None
    camera_found: bool = False
    masks: SessionMasks | None = None
    check: CameraCheck | None = None
    cables: tuple[CableFit, CableFit] | None = None
    stored: tuple[StoredFrame, ...] = ()
    fits: tuple[FrameFit, ...] = ()
    found: Solved | None = None
    start: Calibration | None = None
    moved: Posed | None = None
    remarks: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, setup: ArmSetup, frames: Sequence[SessionFrame], rig: tuple[ViewRotation, ...] = ()) -> ArmSession:
        """Return an arm before anything is estimated.

        Parameters
        ----------
        setup
            What the arm's session is estimated with.
        frames
            Frames with a pose, its covariance and readings of all outer joints, in the order they were taken.
        rig
            The rotations of the further views against the file that the frames' own results show; those that are clear
            are taken out of the frames.
        """
        readings, names = [frame.result.readings for frame in frames], setup.instrument.joint_names
        model = SessionModel.of(readings, setup.instrument, setup.config, setup.arm)
        lag = SessionLag.of(setup.series, [frame.name for frame in frames], model.deviations.outer, setup.lag)
        modes = tuple(Mode.all_of(frame.result, names) for frame in frames)
        change = np.zeros(3) if setup.refine_camera else None
        return cls(setup, tuple(frames), modes, model, lag, rig, change)

    @property
    def solution(self) -> Solved:
        """The current solution."""
        assert self.found is not None
        return self.found

    @property
    def calibration(self) -> Calibration:
        """The calibration from which the next round starts."""
        return self.solution.calibration if self.start is None else self.start

    def subset(self, index: Sequence[int]) -> ArmSession:
        """Return the arm with the frames at some indices, before their first fit."""
        return replace(
            self,
            frames=tuple(self.frames[i] for i in index),
            modes=tuple(self.modes[i] for i in index),
            model=self.model.subset(index),
            lag=self.lag.subset(index),
            stored=tuple(self.stored[i] for i in index) if self.stored else (),
        )

    def noted(self, *, remarks: Sequence[str] = (), undetermined: Sequence[str] = ()) -> ArmSession:
        """Return the arm with further texts."""
        return replace(self, remarks=(*self.remarks, *remarks), undetermined=(*self.undetermined, *undetermined))

    @property
    def times(self) -> Float64:
        """Times (N,) of the frames, s; NaN where unknown."""
        read = self.lag.seconds()
        return np.full(len(self.frames), np.nan) if read is None else read

    @property
    def taken_off(self) -> float:
        """Margin, px, that is taken off all masks."""
        return 0.0 if self.masks is None else self.masks.taken_off

    @property
    def of_camera_and_masks(self) -> Float64:
        """Mean square (K, K) of the calibration's errors that errors of the camera and of all masks cause."""
        assert self.check is not None
        by_margin = () if self.masks is None else self.masks.by_margin
        if self.masks is None or not by_margin:
            return self.check.covariance
        return np.asarray(self.check.covariance + self.masks.square * np.outer(by_margin, by_margin))

    @property
    def common(self) -> CommonErrors:
        """The errors that the frames share."""
        by_lag = self.lag.change_of_predictions(self.model, self.solution.calibration)
        return CommonErrors(self.times, by_lag, self.setup.config.session.alike_seconds)

    def outlines(self, *, keep_all: bool = False) -> FrameFits:
        """Return the current fits; without the outlines that do not explain the mask, unless ``keep_all``."""
        fits = [fit if fit.explains_mask or keep_all else fit.without_outline() for fit in self.fits]
        return FrameFits.of(fits, self.common)

    def outlined(self, *tested: SeenBlock, file_is_prior: bool = False) -> ArmOutlines:
        """Return the outlines of all frames in one view about their fits, as functions of camera, margin and others.

        The view is that of the reference camera; another one if that does not show the instrument in any frame.
        ``file_is_prior`` is whether the camera's file is the prior of the camera, ``tested`` are the other blocks.
        """
        shown = [stored for stored in self.stored if stored.in_reference] or self.stored
        name, pairs = str(shown[0].views[0].name), zip(self.fits, self.stored, strict=True)
        numbers = [stored.number_of(name) if fit.explains_mask else None for fit, stored in pairs]
        file = file_deviations(self.stored[0].camera, self.setup.config.camera) if file_is_prior else None
        blocks = CameraChange(file, self.change), MaskMargin(self.taken_off), *tested
        at, shared = Posed.stacked(one.at for one in self.fits), (self.setup.run, self.common)
        return ArmOutlines(self.model, self.solution.calibration, at, self.stored, numbers, *shared, blocks)

    @property
    def disagreements(self) -> list[str]:
        """Why each frame disagrees with the calibration; an empty text where it agrees."""
        misfits = self.solution.misfit / (6 + len(self.model.names))
        return [self._disagreement(fit, misfit) for fit, misfit in zip(self.fits, misfits.tolist(), strict=True)]

    @property
    def agreeing(self) -> int:
        """Number of frames that agree with the session."""
        return self.disagreements.count("")

    def _disagreement(self, fit: FrameFit, misfit: float = 0.0) -> str:
        """Say why a fit disagrees, whose squared distance from what is expected, per parameter, is ``misfit``."""
        most = self.setup.config.session.largest_misfit
        return frame_disagrees(misfit, most, None if fit.explains_mask else (fit.iou, fit.own_iou)) or ""

    def check_agreement(self, disagreements: Sequence[str] | None = None) -> None:
        """Refuse an arm of which fewer than `LEAST_FRAMES` agree, by default as to whether fits explain their masks.

        Parameters
        ----------
        disagreements
            Why each frame disagrees; an empty text where it agrees.

        Raises
        ------
        InputError
            Names frames that do not agree, with by how much, and what to try.
        """
        texts = [self._disagreement(fit) for fit in self.fits] if disagreements is None else disagreements
        named = zip(self.frames, texts, strict=True)
        off = [f"{frame.name} {text.removeprefix(f'{DISAGREES}: ')}" for frame, text in named if text]
        agree = len(self.frames) - len(off)
        if agree < LEAST_FRAMES:
            more = f"; and {len(off) - _MOST_NAMED} more" if len(off) > _MOST_NAMED else ""
            raise InputError(
                f"session: expected at least {LEAST_FRAMES} frames that agree on where the arm's base is, got {agree} "
                f"of {len(self.frames)} ({'; '.join(off[:_MOST_NAMED])}{more}): {_TO_TRY}"
            )

    def camera_refused(self, reason: str) -> InputError:
        """Return the refusal to find the camera of a session that does not determine it."""
        if self.setup.guessed_camera:
            needed = "--camera: expected a camera file, which these frames do not replace"
            return InputError(f"{needed}: {reason} (dvrk-cmaes help uncalibrated)")
        return InputError(f"--refine-camera: {reason}")


Arms = list[ArmSession]
"""The arms of a session."""


def initialised(arm: ArmSession) -> ArmSession:
    """Find the camera_from_base that most frames of an arm agree on, and faults of its session.

    The lag of the arm is taken out of the readings.

    Raises
    ------
    InputError
        The arm does not move, the readings only fit another arm or tool, or too few frames remain; or the camera is to
        be refined, and the session does not determine it.
    """
    check_motion(arm.model)
    if arm.change is not None and (reason := camera_undetermined(arm.model)):
        raise arm.camera_refused(reason)
    arm, consensus = _on_one_base(_less_lag(arm))
    return replace(arm, found=solve_with_modes(arm.model, arm.modes, consensus.calibration))


def _less_lag(arm: ArmSession) -> ArmSession:
    """Correct the readings by the lag if it differs from zero; frames without readings then are left out."""
    applied = arm.lag.applied
    if applied is None:
        return arm
    has = arm.lag.has_readings(arm.lag.value)
    left_out = {frame.name: NO_READINGS_AT_LAG for frame, own in zip(arm.frames, has, strict=True) if not own}
    arm = replace(arm.subset(np.flatnonzero(has).tolist()), left_out={**arm.left_out, **left_out})
    if len(arm.frames) < LEAST_FRAMES:
        raise InputError(
            f"session: {applied.describe()}, which leaves {len(arm.frames)} frames with readings; "
            f"expected at least {LEAST_FRAMES}"
        )
    return replace(arm, model=arm.lag.model_at(arm.model, arm.lag.value))


def _on_one_base(arm: ArmSession) -> tuple[ArmSession, Consensus]:
    """Return the consensus of the frames, in pieces if the base moved between them."""
    consensus = find_consensus_at_any_roll(arm.model, arm.modes)
    check_arm(arm.model, arm.modes, consensus)
    if arm.model.endoscope is not None or not arm.setup.may_cut:
        return arm, consensus
    alike = float(np.median(frames_alike(arm.times, arm.setup.config.session.alike_seconds)))
    pieces = find_pieces(arm.model, arm.modes, consensus, alike=alike)
    if pieces is None:
        return arm, consensus
    cut = replace(arm, model=replace(arm.model, endoscope=pieces))
    cut = cut.noted(remarks=[describe_pieces(pieces, arm.frames)])
    return cut, find_consensus_at_any_roll(cut.model, cut.modes)


def solved(arms: Arms) -> Arms:
    """Alternate between fitting the frames of all arms and estimating the blocks that they share.

    In the first two rounds the standard deviations of predictions are widened. Before the last one, whose fits are the
    results, the margin of the masks is estimated, or the camera, where it is to be refined.

    Raises
    ------
    InputError
        Too few frames of an arm agree, or the camera is to be refined and its estimate is not plausible.
    """
    setup = arms[0].setup
    arms = [_with_evidence(arm) for arm in arms]
    for number in range(1, _ROUNDS + 1):
        for arm in arms:
            arm.setup.progress(f"round {number} of {_ROUNDS}", len(arm.frames))
        scale = setup.config.session.loosened ** max(1 - (number - 1) / 2, 0.0)
        last = number == _ROUNDS
        fitted = [_fitted_in(arm, scale, last=last) for arm in arms]
        arms = _estimated(fitted, keep_all=scale != 1.0, last=last)
        if setup.refine_camera and not last:
            arms = _with_camera(arms)
        elif number == _ROUNDS - 1:
            arms = _with_margin(arms)
    if setup.refine_camera and not all(arm.camera_found for arm in arms):
        raise arms[0].camera_refused(IMPLAUSIBLE)
    return _finished(arms)


def _with_evidence(arm: ArmSession) -> ArmSession:
    """Gather the evidence of an arm's frames."""
    arm.setup.progress("gathering evidence", len(arm.frames))
    tasks = [(frame, turns_of(arm.rig), None) for frame in arm.frames]
    return replace(arm, stored=tuple(arm.setup.run(gather_task, tasks)))


def _fitted_in(arm: ArmSession, scale: float, *, last: bool) -> ArmSession:
    """Fit the frames of an arm in a round, each from its starts.

    A frame without any keeps the linearisation of its outline, whose minimum is its fit in the ``last`` round.
    """
    angle = float(np.deg2rad(arm.setup.config.session.turn_deg))
    expected = arm.model.priors(arm.calibration, scale=scale)
    agrees, starts = arm.solution.misfit / (6 + len(arm.model.names)) < INLIER_MISFIT, list[tuple[Posed, ...]]()
    if not arm.fits:
        chosen = choose_modes(arm.model, arm.modes, arm.solution.calibration)
    for i, (prior, clear) in enumerate(zip(expected, agrees.tolist(), strict=True)):
        if not arm.fits:
            before, fit = (chosen[i].at,) if clear else tuple(mode.at for mode in arm.modes[i]), None
        else:
            fit = None if arm.moved is not None else arm.fits[i]
            before, clear = (
                (arm.fits[i].at if arm.moved is None else arm.moved[i],),
                clear and arm.fits[i].explains_mask,
            )
        starts.append(starts_of(before, prior, angle, agrees=clear, fit=fit))
    again = [i for i, of_frame in enumerate(starts) if of_frame]
    tasks = [(arm.stored[i], expected[i], starts[i], arm.change, arm.taken_off) for i in again]
    fits = {i: fit.moved_to(expected[i]) if last else fit for i, fit in enumerate(arm.fits)}
    fits |= zip(again, arm.setup.run(fit_task, tasks), strict=True)
    return replace(arm, fits=tuple(fits[i] for i in range(len(arm.frames))))


def _estimated(arms: Arms, *, keep_all: bool, last: bool) -> Arms:
    """Estimate base, offsets, variances and cables of all arms from the current fits.

    ``keep_all`` is whether fits that do not explain the mask count as well. Cables must be more likely by a margin in
    the ``last`` round. `InputError` if too few fits count.
    """
    if not keep_all:
        for arm in arms:
            arm.check_agreement()
    fits = [arm.outlines(keep_all=keep_all) for arm in arms]
    arms = [replace(arm, start=None, moved=None) for arm in _with_variances(arms, fits)]
    if not keep_all and arms[0].setup.config.session.cables:
        arms = [_with_cables(arm, own, MARGIN if last else 0.0) for arm, own in zip(arms, fits, strict=True)]
        if any(arm.cables is not None and arm.cables[0].parts for arm in arms):
            arms = _with_variances(arms, fits)
    return arms


def _with_variances(arms: Arms, fits: Sequence[FrameFits]) -> Arms:
    """Estimate the calibrations together with the variances."""
    session, usual = arms[0].setup.config.session, []
    for arm in arms:
        own = Deviations.of(session, arm.model.names)
        usual.append(own if arm.cables is None else arm.cables[0].deviations(own))
    frames = [ArmFrames(arm.model, own, arm.calibration) for arm, own in zip(arms, fits, strict=True)]
    models, solutions = solve_with_variances(frames, session, usual)
    each = zip(arms, models, solutions, strict=True)
    return [replace(arm, model=model, found=own) for arm, model, own in each]


def _with_cables(arm: ArmSession, fits: FrameFits, margin: float) -> ArmSession:
    """Fit what cables do to the readings, besides the blocks: `cables` says why."""
    usual, std = Deviations.of(arm.setup.config.session, arm.model.names), arm.model.offset_std[1:]
    cables = estimate_cables(arm.model, fits, arm.solution, arm.lag, usual, std, margin)
    own = cables[0].deviations(arm.model.deviations)
    model = replace(arm.model, correction=cables[0].correction, deviations=own)
    return replace(arm, cables=cables, model=model)


def _by_camera(arms: Arms) -> list[list[int]]:
    """Return the numbers of the arms that are seen by one camera, for each camera."""
    cameras = [arm.stored[0].camera for arm in arms]
    first = [cameras.index(camera) for camera in cameras]
    return [[k for k, own in enumerate(first) if own == one] for one in dict.fromkeys(first)]


def _with_camera(arms: Arms) -> Arms:
    """Estimate the change of the camera, and use it where it is plausible."""
    out = list(arms)
    for group in _by_camera(arms):
        seen = [arms[k].outlined() for k in group]
        estimates = linearise(seen, arms[group[0]].setup.config.session, [CAMERA], passes=_CAMERA_PASSES)
        found = all(estimate.plausible for estimate in estimates)
        for k, own in zip(group, estimates, strict=True):
            out[k] = replace(arms[k], camera_found=found)
            if found:
                start = own.solution.calibration.alone()
                out[k] = replace(out[k], change=own.value(CAMERA), start=start, moved=own.at)
    return out


def _with_margin(arms: Arms) -> Arms:
    """Estimate the margin of the masks, and take it off."""
    out = list(arms)
    for group in _by_camera(arms):
        seen = [arms[k].outlined(file_is_prior=True) for k in group]
        masks, without = estimate_margin(seen, arms[group[0]].setup.config.session)
        for k, (own, moved) in zip(group, without, strict=True):
            out[k] = replace(arms[k], masks=masks, start=own, moved=moved)
    return out


def _finished(arms: Arms) -> Arms:
    """Solve once more with all that was found from the fits of the last round."""
    near = []
    found = solve_arms([ArmFrames(arm.model, arm.outlines(), arm.solution.calibration) for arm in arms])
    for arm, own in zip(arms, found, strict=True):
        pairs = zip(arm.fits, arm.model.priors(own.calibration), strict=True)
        fits = tuple(fit.moved_to(prior) if fit.step_to(prior) < _NEAR else fit for fit, prior in pairs)
        near.append(replace(arm, fits=fits, found=own))
    return near


def checked(arms: Arms) -> Arms:
    """Test whether the frames contradict the camera file, the instrument's sizes and the further blocks.

    The evidence of the returned arms is as seen by the camera that is used.
    """
    out = list(arms)
    for group in _by_camera(arms):
        seen = []
        for arm in (arms[k] for k in group):
            arm.setup.progress("checking the camera", len(arm.frames))
            camera, config = arm.outlined().camera, arm.setup.config
            tested = InstrumentSizes(arm.setup.instrument), *(make(config, camera) for make in TESTED)
            seen.append(arm.outlined(*tested))
        checks = check_camera(seen, arms[group[0]].setup.config, applied=arms[group[0]].change)
        for k, check in zip(group, checks, strict=True):
            out[k] = _with_check(replace(arms[k], check=check), check)
    return out


def _with_check(arm: ArmSession, check: CameraCheck) -> ArmSession:
    """Return an arm with what was found in the test of its camera, in words and in what it does to the solution."""
    if check.of_margin is not None:
        masks = check.of_margin.stated(arm.masks)
        arm = replace(arm, masks=masks)
    if check.camera is None:
        arm = arm.noted(undetermined=[check.undetermined])
    elif arm.setup.guessed_camera:
        arm = arm.noted(remarks=[check.camera.describe_found(arm.stored[0].camera)])
    elif check.camera.applied:
        arm = arm.noted(remarks=check.camera.contradictions())
    if arm.change is not None:
        tasks = [(frame, turns_of(arm.rig), arm.change) for frame in arm.frames]
        arm = replace(arm, stored=tuple(arm.setup.run(gather_task, tasks)))
    return arm
