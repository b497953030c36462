"""A session as one least-squares problem: the frames of its arms, and the blocks of unknowns that these share.

By the frames' own modes `started` finds the endoscope and the lag, and `initialised` the camera_from_base that most
frames of an arm agree on, in pieces where it moved. `solved` then alternates: each frame is fitted to its outline with
what the blocks predict as a prior, and the blocks of all arms are estimated from all fits. `checked` tests the camera,
the instrument's sizes and the masks, by the same fits.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import BlockCheck, FoundBlock
from dvrk_cmaes.calibration.cables import estimate_cables
from dvrk_cmaes.calibration.consensus import (
    agreement,
    check_arm,
    check_motion,
    evenly_spaced,
    find_consensus_at_any_roll,
)
from dvrk_cmaes.calibration.endoscope import Pieces, Place, Steered
from dvrk_cmaes.calibration.frame_fit import IN_SESSION, WHERE_IT_IS, starts_of
from dvrk_cmaes.calibration.lag import NO_READINGS_AT_LAG, in_common
from dvrk_cmaes.calibration.lag_search import find_lag
from dvrk_cmaes.calibration.masks_and_sizes import MARGIN, square_left
from dvrk_cmaes.calibration.model import SessionModel, ecm_readings, frames_alike, outer_readings, usual_deviations
from dvrk_cmaes.calibration.session_camera import (
    CAMERA,
    IMPLAUSIBLE,
    camera_undetermined,
    describe_found,
    places_of,
    turns_of,
)
from dvrk_cmaes.calibration.session_endoscope import LEAST_PIECE, describe_pieces, find_hand_eye, find_pieces
from dvrk_cmaes.calibration.session_frame import SessionFrame, fit_task, gather_task
from dvrk_cmaes.calibration.session_problem import LEAST_FRAMES, Arms, ArmSession, ArmSetup
from dvrk_cmaes.calibration.solve import Solved, solve_arms, solve_with_modes, solve_with_variances
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.expected_error import file_covariance
from dvrk_cmaes.results.result import Result

_PASSES = 6  # largest number of linearisations of the outlines
_ROUNDS = 3  # in which frames and blocks are estimated in turn
_FEW = 100  # frames, by which the tested blocks are estimated; others near them in time err alike
_NEAR = 1.0  # standard deviations per parameter, by which fits move to where the last solution expects them
_MOVED_SHARE = 0.1  # of the frames, that agree only if the session is cut where its base moved
_AGREE: Final = 4.0  # standard deviations of each unknown, within which arms find the same endoscope
_OTHER_TIP: Final = (
    "the arms show another camera in the endoscope's tip: each has its own; one arm's readings may be wrong"
)
_HAND_EYE: Final = 10  # unknowns that do not differ from place to place
_LEAST_TESTED = 6  # frames, by which a camera is tested
_NOT_ASKED = "camera: not tested, as the settings say"
_LEAST_COUNTED = 0.5  # of the frames that explain their masks at the file's camera, by which another one is found
_LEAST_AGREEING = 0.7  # of the frames, from which on others are predicted from them


def solve_session(arms: Arms) -> Arms:
    """Solve the arms of a session in one problem; one that is cut where the base moved is also solved in one piece.

    Frames near each other in time, whose masks err alike, agree with each other whatever they show. So a session stays
    cut only if that explains clearly more frames.

    Raises
    ------
    InputError
        As `initialised` and `solved`.
    """
    arms = started(arms)
    session = solved(_with_common_endoscope([initialised(arm) for arm in arms]))
    if any(isinstance(arm.model.endoscope, Pieces) for arm in session):
        with contextlib.suppress(InputError):
            whole = solved([initialised(arm, may_cut=False) for arm in arms])
            gain = sum(one.agreeing - other.agreeing for one, other in zip(session, whole, strict=True))
            if gain < max(LEAST_PIECE, _MOVED_SHARE * sum(len(arm.frames) for arm in session)):
                session = whole
    return checked(session)


def started(arms: Arms) -> Arms:
    """Find the camera in the tip of an endoscope that is read and moves, and the lag, by the modes of the frames.

    The places where the endoscope stands are those that the first arm finds.
    """
    found, places = list[ArmSession](), tuple[Place, ...]()
    for arm in arms:
        steered = Steered.of(ecm_readings([frame.result.readings for frame in arm.frames]), places)
        if steered is not None:
            places = places or steered.places
            arm.setup.progress("finding the camera in the endoscope", len(arm.frames))
            arm = replace(arm, model=replace(arm.model, endoscope=find_hand_eye(arm, steered)))
        found.append(replace(arm, lag=find_lag(arm)))
    common = in_common([arm.lag for arm in found])
    return [replace(arm, lag=lag) for arm, lag in zip(found, common, strict=True)]


def initialised(arm: ArmSession, *, may_cut: bool = True) -> ArmSession:
    """Find the camera_from_base that most frames of an arm agree on, and faults of its session.

    The lag of the arm is taken out of the readings. ``may_cut`` is whether the session may be cut into pieces between
    which the base moved.

    Raises
    ------
    InputError
        The arm does not move, the readings only fit another arm or tool, or too few frames remain; or the camera is to
        be refined, and the session does not determine it.
    """
    check_motion(arm.model)
    if arm.change is not None and (reason := camera_undetermined(arm.model)):
        raise arm.camera_refused(reason)
    arm = _less_lag(arm)
    consensus = find_consensus_at_any_roll(arm)
    check_arm(arm, consensus)
    if may_cut and arm.model.endoscope is None:
        alike = float(np.median(frames_alike(arm.lag.seconds(), arm.setup.config.session.alike_seconds)))
        pieces = find_pieces(arm, consensus, alike)
        if pieces is not None:
            arm = replace(arm, model=replace(arm.model, endoscope=pieces))
            arm = arm.noted(remarks=[describe_pieces(pieces, arm.frames)])
            consensus = find_consensus_at_any_roll(arm)
    return replace(arm, found=solve_with_modes(arm, consensus.calibration))


def _less_lag(arm: ArmSession) -> ArmSession:
    """Correct the readings by the lag if it differs from zero; frames without readings then are left out."""
    applied, series = arm.lag.applied, arm.lag.series
    if applied is None or series is None:
        return arm
    has = arm.lag.has_readings(arm.lag.value)
    left_out = {frame.name: NO_READINGS_AT_LAG for frame, own in zip(arm.frames, has, strict=True) if not own}
    arm = replace(arm.subset(np.flatnonzero(has).tolist()), left_out={**arm.left_out, **left_out})
    if len(arm.frames) < LEAST_FRAMES:
        raise InputError(
            f"session: {applied.describe()}, which leaves {len(arm.frames)} frames with readings; "
            f"expected at least {LEAST_FRAMES}"
        )
    read = [replace(one.result, readings=series.of_frame(one.name, applied)) for one in arm.frames]
    frames = tuple(replace(one, result=own) for one, own in zip(arm.frames, read, strict=True))
    return replace(arm, frames=frames, model=arm.lag.model_at(arm.model, arm.lag.value))


def _with_common_endoscope(arms: Arms) -> Arms:
    """Return arms of which those that find the endoscope of the first one share it: it stands in the problem once.

    Of one that is not read, these are the moves of the camera between pieces, where the arms have the same pieces.
    """
    first, out = arms[0], list[ArmSession]()
    known, own = first.model.endoscope, first.calibration.endoscope
    if known is None or own is None or len(arms) == 1:
        return arms
    for arm in arms:
        endoscope, theirs = arm.model.endoscope, arm.calibration.endoscope
        if endoscope is None or theirs is None or len(endoscope.block.std) != len(known.block.std):
            out.append(arm)
            continue
        apart = np.abs(known.block.deviation(own) - known.block.deviation(theirs))
        of_both = [one.solution.covariance[(one.calibration.place("endoscope"),) * 2] for one in (first, arm)]
        differ, read = apart > _AGREE * np.sqrt(np.diag(sum(of_both))), isinstance(known, Steered)
        if differ[: _HAND_EYE if read else None].any():
            out.append(arm.noted(remarks=[_OTHER_TIP]) if read else arm)
            continue
        shared = known.block.in_common()
        endoscope = replace(endoscope, block=shared, start=known.start, loose=known.loose)
        arm = arm.with_calibration(arm.calibration.with_blocks(shared, endoscope=own))
        out.append(replace(arm, model=replace(arm.model, endoscope=endoscope)))
    return out


def solved(arms: Arms) -> Arms:
    """Alternate between fitting the frames of all arms and estimating the blocks that they share.

    Before the last round, whose fits are the results, the margin of the masks is estimated, or the camera, where it is
    to be refined. At the end all is solved once more from the fits of the last round.

    Raises
    ------
    InputError
        Too few frames of an arm agree, or the camera is to be refined and its estimate is not plausible.
    """
    setup = arms[0].setup
    for arm in arms:
        arm.setup.progress("gathering evidence", len(arm.frames))
    arms = [_with_evidence(arm) for arm in arms]
    for number in range(1, _ROUNDS + 1):
        for arm in arms:
            arm.setup.progress(f"round {number} of {_ROUNDS}", len(arm.frames))
        arms = _estimated([_fitted(replace(arm, last=number == _ROUNDS)) for arm in arms])
        if number == _ROUNDS - 1 or (setup.refine_camera and number < _ROUNDS):
            arms = _with_seen(arms, last=number == _ROUNDS - 1)
    found, out = solve_arms([arm.outlines() for arm in arms]), []
    for arm, own in zip(arms, found, strict=True):
        pairs = zip(arm.fits, arm.model.priors(own.calibration), strict=True)
        fits = tuple(fit.moved_to(prior) if fit.step_to(prior) < _NEAR else fit for fit, prior in pairs)
        out.append(arm.with_solution(own, fits=fits))
    return out


def _with_evidence(arm: ArmSession) -> ArmSession:
    """Gather the evidence of an arm's frames, as seen by the camera that is used."""
    tasks = [(frame, turns_of(arm.rig), arm.change if arm.fits else None) for frame in arm.frames]
    return replace(arm, stored=tuple(arm.setup.run(gather_task, tasks)))


def _fitted(arm: ArmSession) -> ArmSession:
    """Fit the frames of an arm in a round, each from its starts.

    A frame without any keeps the linearisation of its outline, whose minimum is its fit in the last round.
    """
    expected = arm.model.priors(arm.calibration)
    agrees = arm.solution.agree.tolist()
    before: list[tuple[Posed, ...]]
    if arm.fits:
        agrees = [clear and fit.explains_mask for clear, fit in zip(agrees, arm.fits, strict=True)]
        before = [(arm.at[k],) for k in range(len(arm.frames))]
    else:
        of_frames = zip(agrees, agreement(arm, arm.calibration).chosen.tolist(), arm.counts.tolist(), strict=True)
        numbers = [(best,) if clear else range(count) for clear, best, count in of_frames]
        before = [tuple(arm.modes[i][k] for k in of_frame) for i, of_frame in enumerate(numbers)]
    fits = arm.fits if arm.moved is None and arm.fits else (None,) * len(arm.frames)
    each = zip(before, expected, agrees, fits, strict=True)
    starts = [starts_of(at, prior, agrees=clear, fit=fit) for at, prior, clear, fit in each]
    again = [i for i, of_frame in enumerate(starts) if of_frame]
    preset, shown, blocks = WHERE_IT_IS if arm.seen else IN_SESSION, arm.shown, arm.seen_as
    tasks = [(arm.stored[i], expected[i], starts[i], preset, shown[i], blocks) for i in again]
    found = {i: fit.moved_to(expected[i]) if arm.last else fit for i, fit in enumerate(arm.fits)}
    found |= zip(again, arm.setup.run(fit_task, tasks), strict=True)
    return replace(arm, fits=tuple(found[i] for i in range(len(arm.frames))), moved=None)


def _estimated(arms: Arms) -> Arms:
    """Estimate base, offsets, variances and cables of all arms from the current fits that explain their masks.

    Cables must be more likely by a margin in the last round. `InputError` if too few fits count.
    """
    for arm in arms:
        arm.check_agreement()
    config = arms[0].setup.config.session
    solved = solve_with_variances([arm.outlines() for arm in arms], config)
    arms = [arm.with_solution(own) for arm, own in zip(arms, solved, strict=True)]
    if config.cables:
        arms = [_with_cables(arm) for arm in arms]
        if any(arm.cables is not None and arm.cables[0].parts for arm in arms):
            solved = solve_with_variances([replace(arm.solution, model=arm.model) for arm in arms], config)
            arms = [arm.with_solution(own) for arm, own in zip(arms, solved, strict=True)]
    return arms


def _with_cables(arm: ArmSession) -> ArmSession:
    """Fit what cables do to the readings, besides the blocks: `cables` says why."""
    usual = usual_deviations(arm.setup.config.session, arm.model.names)
    cables = estimate_cables(arm.solution, arm.lag, usual, last=arm.last)
    usual, own = (cables[0].deviations(one) for one in (usual, arm.model.deviations))
    model = replace(arm.model, correction=cables[0].correction, deviations=own, usual=usual)
    return replace(arm, cables=cables, model=model)


def _with_seen(arms: Arms, *, last: bool) -> Arms:
    """Estimate what is seen otherwise than files have it, and use it: the camera, if it is refined, else the margin.

    Without refinement the file is a measurement of the camera: an estimate of it is not used. `InputError` if the
    camera's estimate is not plausible at ``last``.
    """
    refine, out = arms[0].setup.refine_camera, list[ArmSession]()
    _, estimates = _tested(arms)
    if not all(own.is_plausible for own in estimates):
        if last:
            raise arms[0].camera_refused(IMPLAUSIBLE)
        return arms
    for arm, own in zip(arms, estimates, strict=True):
        if refine:
            arm = replace(arm, change=own.value(CAMERA))
        else:
            margin = next(one for one in own.calibration.tested if one.name == MARGIN)
            arm = replace(arm, margin=margin.stated(*estimates[0].shown_of(margin))[0])
        whole = own if len(arm.frames) <= _FEW else replace(arm.outlines(tested=True), calibration=own.calibration)
        out.append(arm.with_calibration(own.calibration.alone(), moved=whole.at))
    return out


def _tested(arms: Arms, passes: int = _PASSES) -> tuple[list[Solved], list[Solved]]:
    """Estimate the blocks that are tested with the calibrations of arms, by few of many frames.

    Returns the estimates by the outlines as they are linearised at the values in use, and by those of frames that are
    fitted again with the blocks that are found, until these are settled.
    """
    arms = [arm.subset(evenly_spaced(len(arm.frames), _FEW)) for arm in arms]
    config = arms[0].setup.config.session
    first = found = solve_with_variances([arm.outlines(tested=True) for arm in arms], config)
    for _ in range(passes - 1):
        if all(own.is_settled for own in found) or not all(own.is_plausible for own in found):
            break
        pairs = zip(arms, found, strict=True)
        arms = [_fitted(arm.with_solution(own, moved=own.at, seen=own.calibration.values)) for arm, own in pairs]
        found = solve_with_variances([arm.outlines(tested=True) for arm in arms], config)
    return first, found


def checked(arms: Arms) -> Arms:
    """Check camera, instrument and other blocks of arms that are solved, and note what is found of the camera.

    Where a camera that is not used is not plausible, only what the frames show at that of the file is left, which may
    contradict it or say nothing. Where that is not plausible either, or far fewer outlines explain their masks with the
    camera that is found, only the margin of the masks is determined. The evidence of the returned arms is as seen by
    the camera that is used.
    """
    for arm in arms:
        arm.setup.progress("checking the camera", len(arm.frames))
    session, refined = arms[0].setup.config.session, arms[0].change is not None
    reasons = [camera_undetermined(arm.model, _LEAST_TESTED, "test") for arm in arms]
    reason = None if None in reasons else reasons[0]
    if not session.test_camera and not refined:
        reason = _NOT_ASKED
    passes = 1 if refined or reason == _NOT_ASKED else _PASSES
    at_file, found = _tested(arms, passes)
    lost = any(own.counted < _LEAST_COUNTED * first.counted for own, first in zip(found, at_file, strict=True))
    if far := passes > 1 and (lost or not all(own.is_plausible for own in found)):
        found, lost = at_file, lost or not all(own.is_plausible for own in at_file)
    out = [_checked(*each, reason, far=far, lost=lost) for each in zip(arms, found, strict=True)]
    return [_with_evidence(arm) for arm in out] if refined else out


def _checked(arm: ArmSession, solved: Solved, reason: str | None, *, far: bool, lost: bool) -> ArmSession:
    """Judge the estimates of an arm.

    ``reason`` is why the camera is not tested, ``far`` whether its estimate was not plausible, and ``lost`` whether for
    that nothing but the margin is determined.
    """
    config, blocks = arm.setup.config, dict[str, FoundBlock]()
    errors, covariance = file_covariance(arm.camera, config.camera), np.zeros((arm.calibration.own,) * 2)
    for block in solved.calibration.tested:
        alone, spread = solved.shown_of(block)
        found, left = block.stated(alone, config.session.shared_errors**2 * spread if block.is_alike else spread)
        if block.name == MARGIN and arm.margin is not None:
            found, left = arm.margin, square_left(arm.margin)
        moves, of_errors = solved.moved_by(block), np.ix_(*[places_of(block.parameters)] * 2)
        if block.name == CAMERA and (reason or lost or (far and not found.doubt)):
            left = errors[of_errors]
            arm = arm.noted(undetermined=[reason or IMPLAUSIBLE])
        elif lost and block.name != MARGIN:
            left = errors[of_errors] if block.parameters else np.diag(block.known**2)
        else:
            blocks[block.name] = found.moving(moves)
        if block.parameters:
            errors[of_errors] = left
        if block.widens:
            covariance += moves @ left @ moves.T
    camera, arm = blocks.get(CAMERA), replace(arm, check=BlockCheck(covariance, errors, blocks))
    if camera is not None and arm.setup.guessed_camera:
        return arm.noted(remarks=[describe_found(camera, arm.stored[0].camera)])
    return arm.noted(remarks=[camera.doubt]) if camera is not None and camera.applied and camera.doubt else arm


def predict_from_first(
    first: Sequence[SessionFrame], others: Mapping[str, Mapping[str, float]], setup: ArmSetup
) -> dict[str, Result]:
    """Predict frames of a recording from the modes of its ``first`` frames, in the order they were taken.

    Returns results, like that of a first frame, at the poses from which the frames start, by name; without the frames
    that have no readings of all outer joints at the time of their image less the lag. Empty if the first frames do not
    agree, or the base moved: in which piece the others are is not known yet.

    Parameters
    ----------
    first
        Frames that were estimated by themselves.
    others
        The readings of the frames to predict, by name, rad and m; those of first frames that agree do not count.
    setup
        The recording's instrument, arm, settings and all readings.
    """
    found = [frame for frame in first if not frame.lacks]
    try:
        arm = initialised(started([ArmSession.of(setup, found)])[0])
    except InputError:  # too few frames, or they contradict each other: then they show nothing about the others
        return {}
    endoscope, lag, series = arm.model.endoscope, arm.lag.applied, setup.series
    if arm.solution.agree.mean() < _LEAST_AGREEING or isinstance(endoscope, Pieces):
        return {}
    agree = {frame.name for frame, agrees in zip(arm.frames, arm.solution.agree.tolist(), strict=True) if agrees}
    readings = {
        name: own if lag is None or series is None or name not in series.frames else series.of_frame(name, lag)
        for name, own in others.items()
        if name not in agree
    }
    readings = {name: own for name, own in readings.items() if not np.isnan(outer_readings([own])).any()}
    if not readings:
        return {}
    read = [*readings.values()]
    endoscope = None if endoscope is None else endoscope.at(ecm_readings(read))
    model = SessionModel.of(read, setup.instrument, setup.config, setup.arm, endoscope)
    at, like = model.predict(arm.calibration), replace(found[0].result, alternatives=())
    joints = [dict(zip(setup.instrument.joint_names, own, strict=True)) for own in at.joints.tolist()]
    return {name: replace(like, camera_from_root=at.pose[i], joints=joints[i]) for i, name in enumerate(readings)}
