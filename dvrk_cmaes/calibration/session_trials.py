"""Solutions of one session from several starts, of which that one is taken that predicts left-out frames best.

A session is solved at several lags where its frames' own modes do not tell the lag, in pieces and in one where its base
seems to have moved, and again with masks that were found around its silhouettes. Errors of cables and a lag explain
much of each other in the frames that are fitted; in frames that are left out, they do not.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.consensus import INLIER_MISFIT
from dvrk_cmaes.calibration.endoscope import Pieces, Steered
from dvrk_cmaes.calibration.endoscope_search import LEAST_PIECE, find_hand_eye
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.calibration.lag import MOST_LAGS
from dvrk_cmaes.calibration.lasting_errors import CORRELATED_FRAMES
from dvrk_cmaes.calibration.masks_again import FoundAgain, again_task, compared, predicted_task
from dvrk_cmaes.calibration.model import SessionModel, ecm_readings, outer_readings
from dvrk_cmaes.calibration.session_problem import (
    Arms,
    ArmSession,
    ArmSetup,
    FoundMasks,
    in_pieces,
    initialised,
    solved,
    with_common_lag,
    with_lag_of_fits,
    with_other_masks,
)
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, Posed

Overlaps = Mapping[tuple[int, str], float]
"""Overlap of each frame's masks and the silhouette that the other frames predict, by number of the arm and name."""

_CLEAR = 2.0  # standard deviations of a mean difference, and ...
_LEAST_GAIN = 0.005  # ... of overlap, by which a solution must predict better than another one
_MOVED_SHARE = 0.1  # of the frames, that agree only if the session is cut where its base moved
_WELL = 0.06  # of overlap, by which left-out frames may be worse than their own fits for the session to predict well
_AGREE: Final = 4.0  # standard deviations of each unknown, within which arms find the same endoscope
_OTHER_TIP: Final = (
    "the arms tell another camera in the endoscope's tip: each has its own; one arm's readings may be wrong"
)
_HAND_EYE: Final = 10  # unknowns that do not differ from place to place


def solve_session(arms: Arms) -> Arms:
    """Solve the arms of a session in one problem; one that is cut where the base moved is also solved in one piece.

    Frames near each other in time, whose masks err alike, agree with each other whatever they show. So a session stays
    cut only if that explains clearly more frames. Masks that were found in images are then found again.

    Raises
    ------
    InputError
        As `session_problem.initialised` and `solved`.
    """
    session = _solved_at_its_lag(arms)
    if any(isinstance(arm.model.endoscope, Pieces) for arm in session):
        with contextlib.suppress(InputError):
            whole = _solved_at_its_lag([replace(arm, setup=replace(arm.setup, may_cut=False)) for arm in arms])
            gain = sum(sum(one.agreeing) - sum(other.agreeing) for one, other in zip(session, whole, strict=True))
            if gain < max(LEAST_PIECE, _MOVED_SHARE * sum(len(arm.frames) for arm in session)):
                session = whole
    return _with_masks_again(session) if arms[0].setup.config.session.masks_again else session


def started(arms: Arms) -> Arms:
    """Find the endoscope, and the lag by the modes of the frames; pieces where frames agree at no lag in one."""
    found = list[ArmSession]()
    for arm in arms:
        first = found[0].model.endoscope if found else None
        found.append(_with_lag_of_modes(_with_readings(arm, first if isinstance(first, Steered) else None)))
    return with_common_lag(found)


def _with_readings(arm: ArmSession, first: Steered | None) -> ArmSession:
    """Return an arm with its endoscope where the arm that holds it is read and moves, else as it is.

    ``first`` is the endoscope as the first arm finds it, with the places where it stands.
    """
    read = ecm_readings([frame.result.readings for frame in arm.frames])
    steered = Steered.of(read, () if first is None else first.places)
    if steered is None:
        return arm
    arm.setup.progress("finding the camera in the endoscope", len(arm.frames))
    return replace(arm, model=replace(arm.model, endoscope=find_hand_eye(arm.model, arm.modes, steered)))


def _with_lag_of_modes(arm: ArmSession) -> ArmSession:
    """Return an arm with its lag; frames that agree at no lag are cut in pieces, if they agree at one so."""
    arm = replace(arm, lag=arm.lag.searched(arm.model, arm.modes))
    if not arm.lag.nowhere or arm.model.endoscope is not None:
        return arm
    cut = in_pieces(arm)
    if cut is None:
        return arm
    again = replace(cut, lag=cut.lag.searched(cut.model, cut.modes))
    return arm if again.lag.nowhere else again


def _solved_at_its_lag(arms: Arms) -> Arms:
    """Solve a session; where the frames' own modes do not tell the lag, also at others.

    These are the lags that the modes allow and the one that the fits without a lag tell. A solution at such a lag is
    taken where it predicts frames that are left out clearly better than that without; else the fits may tell that there
    is no lag. Where the frames' own modes agree at no lag, such a solution must also predict well: the best of wrong
    ones predicts better than the others by chance. Where they agree about as well at several lags, the one must predict
    clearly better than none and than the others, or none is taken out.
    """
    arms = started(arms)
    several = any(arm.lag.rivals for arm in arms)
    if several:
        arms = [replace(arm, lag=arm.lag.undecided()) if arm.lag.rivals else arm for arm in arms]
    lags = _lags_to_try(arms)
    try:
        session = solved(_initialised(arms))
    except InputError:
        trials = _at_lags(arms, lags)
        if not trials:
            raise
        return trials[int(np.argmax([np.mean(list(_overlaps(trial).values())) for trial in trials]))]
    if not any(arm.lag.can_be_tried for arm in session):
        return session
    session, by_fits = (session, None) if several else with_lag_of_fits(session)
    without_lag = _overlaps(session)
    if by_fits is None and all(arm.lag.lag is not None for arm in session) and _predicts_well(session, without_lag):
        return session
    trials = _at_lags(arms, lags if by_fits is None else [by_fits, *lags])
    overlaps = [_overlaps(trial) for trial in trials]
    best = best_predicting(without_lag, overlaps)
    if best is None:
        return session
    if any(arm.lag.nowhere for arm in session) and not _predicts_well(trials[best], overlaps[best]):
        return session
    apart = [own for trial, own in zip(trials, overlaps, strict=True) if _lags_differ(trial, trials[best])]
    if several and any(best_predicting(own, [overlaps[best]]) is None for own in apart):
        return session
    return trials[best]


def _lags_to_try(arms: Arms) -> list[float]:
    """Return the lags at which a session is solved, the best first, in the unit of its readings' times."""
    lags = list[float]()
    for arm in arms:
        if arm.lag.can_be_tried:
            of_curve = [] if arm.lag.curve is None else arm.lag.curve.to_try
            lags += [lag for lag in (_nonzero(arm) if arm.lag.rivals else of_curve) if lag not in lags]
    return lags[:MOST_LAGS]


def _nonzero(arm: ArmSession) -> list[float]:
    """Return the lags that fit about as well as each other, without one that hardly differs from none."""
    return [lag for lag in arm.lag.rivals if abs(lag) > 0.5 * (arm.lag.step or 0.0)]


def _lags_differ(one: Arms, other: Arms) -> bool:
    """Whether the lags of two solutions differ by more than a frame."""
    pairs = [(a.lag.applied, b.lag.applied) for a, b in zip(one, other, strict=True)]
    frames = [[0.0 if lag is None or lag.frames is None else lag.frames for lag in pair] for pair in pairs]
    return any(abs(first - second) > 1.0 for first, second in frames)


def _at_lags(arms: Arms, lags: Sequence[float]) -> list[Arms]:
    """Solve a session at some lags, but for those that its readings contradict."""
    trials = []
    for lag in lags:
        for arm in arms:
            arm.setup.progress("trying another lag", len(arm.frames))
        tried = [replace(arm, lag=arm.lag.with_trial(lag)) if arm.lag.lag is None else arm for arm in arms]
        with contextlib.suppress(InputError):
            trials.append(solved(_initialised(tried)))
    return trials


def _initialised(arms: Arms) -> Arms:
    """Initialise each arm, and share the endoscope where they agree on it."""
    first, *others = [initialised(arm) for arm in arms]
    return _with_common_endoscope(first, others) if others else [first]


def _with_common_endoscope(first: ArmSession, others: Arms) -> Arms:
    """Return arms of which those that find the endoscope of the first one share it.

    Of one that is not read, these are the moves of the camera between pieces, where the arms have the same pieces.
    """
    endoscope, own = first.model.endoscope, first.solution.calibration.endoscope
    if endoscope is None or own is None:
        return [first, *others]
    first = _with_shared_endoscope(first, first)
    out = [first]
    for other in others:
        theirs, read = other.solution.calibration.endoscope, isinstance(endoscope, Steered)
        if theirs is None or (len(theirs.poses), len(theirs.numbers)) != (len(own.poses), len(own.numbers)):
            out.append(other)
            continue
        apart = np.abs(own.deviation - replace(theirs, expected=own.expected).deviation)
        spread = np.sqrt(np.diag(_of_endoscope(first) + _of_endoscope(other)))
        agree = not (apart > _AGREE * spread)[: _HAND_EYE if read else None].any()
        if not agree and read:
            other = other.noted(remarks=[_OTHER_TIP])
        out.append(_with_shared_endoscope(other, first) if agree else other)
    return out


def _with_shared_endoscope(arm: ArmSession, first: ArmSession) -> ArmSession:
    """Return an arm with the endoscope of the first one, which stands in the problem once."""
    endoscope, known = arm.model.endoscope, first.model.endoscope
    assert endoscope is not None
    assert known is not None
    model = replace(arm.model, endoscope=endoscope.in_common(known.start, known.loose))
    assert model.endoscope is not None
    values = first.solution.calibration.endoscope
    calibration = arm.solution.calibration.beside(model.endoscope.block, endoscope=values)
    return replace(arm, model=model, found=replace(arm.solution, calibration=calibration))


def _of_endoscope(arm: ArmSession) -> Float64:
    """Return the covariance (M, M) of the endoscope's values that the frames of an arm tell."""
    place = arm.solution.calibration.place("endoscope")
    return arm.solution.covariance[place, place]


def _overlaps(arms: Arms) -> Overlaps:
    """Return the overlap of each frame's masks and the silhouette that all other frames predict."""
    found = dict[tuple[int, str], float]()
    for k, arm in enumerate(arms):
        pairs = zip(arm.stored, arm.left_out_predictions(), strict=True)
        measured = arm.setup.run(predicted_task, [(stored, [at], arm.change) for stored, at in pairs])
        found |= {(k, frame.name): iou for frame, ((iou, _),) in zip(arm.frames, measured, strict=True)}
    return found


def best_predicting(first: Overlaps, others: Sequence[Overlaps]) -> int | None:
    """Return which of several solutions predicts the frames best, or None if none is clearly better than the first.

    Parameters
    ----------
    first, others
        Overlap of each frame's mask and the silhouette that the other frames predict.
    """
    gains = []
    for other in others:
        both = sorted(first.keys() & other.keys())
        change = np.array([other[name] - first[name] for name in both])
        error = float(change.std() / np.sqrt(max(len(change) / CORRELATED_FRAMES, 1.0))) if len(change) else np.inf
        gain = float(change.mean()) if len(change) else -np.inf
        gains.append(gain if gain > max(_CLEAR * error, _LEAST_GAIN) else -np.inf)
    best = int(np.argmax(gains)) if gains else 0
    return best if gains and np.isfinite(gains[best]) else None


def _predicts_well(arms: Arms, left_out: Overlaps) -> bool:
    """Whether frames that are left out overlap nearly as well as their fits."""
    fits = [fit.iou for arm in arms for fit in arm.fits]
    return float(np.median(list(left_out.values()))) > float(np.median(fits)) - _WELL


def _with_masks_again(session: Arms) -> Arms:
    """Find the masks again that were found in images, around the fits, and solve again; returns the better solution.

    Masks of frames that agree with the session are found around their fits, those of the others around what the session
    predicts of them; only frames whose masks change are fitted again.
    ``again`` of an arm tells what was compared; it is None without such frames.
    """
    found = [_found_again(arm) for arm in session]
    if not any(found):
        return session
    new = [{i: own.masks for i, own in of_arm.items() if own.masks} for of_arm in found]
    other = with_other_masks(session, new) if any(new) else session
    each = [
        compared(
            [own.iou for own in of_arm.values()],
            len(masks),
            (before.solution.calibration.camera_from_base, after.solution.calibration.camera_from_base),
            _both_predicted(before, after),
            before.stored[0].camera.pixel_scale,
        )
        for of_arm, masks, before, after in zip(found, new, session, other, strict=True)
        if of_arm
    ]
    applied = all(one.applied or not one.changed for one in each) and any(one.applied for one in each)
    told = iter(each)
    better = other if applied else session
    out = []
    for arm, of_arm in zip(better, found, strict=True):
        again = replace(next(told), applied=applied) if of_arm else None
        out.append(replace(arm, again=replace(arm.again or FoundMasks(), compared=again)) if of_arm else arm)
    return out


def _found_again(arm: ArmSession) -> dict[int, FoundAgain]:
    """Find the masks of an arm's frames again."""
    agree, expected = arm.agreeing, arm.model.priors(arm.solution.calibration)
    tasks = {
        i: (frame.data, frame.find_masks, arm.fits[i].at if agree[i] else expected[i].mean, agree[i], arm.change)
        for i, frame in enumerate(arm.frames)
        if frame.find_masks is not None
    }
    if not any(agree[i] for i in tasks):
        return {}
    arm.setup.progress("finding masks again", len(tasks))
    return dict(zip(tasks, arm.setup.run(again_task, list(tasks.values())), strict=True))


def _both_predicted(before: ArmSession, after: ArmSession) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Measure what the other frames predict of the first masks of each agreeing frame, by both solutions."""
    poses = list(zip(before.left_out_predictions(), after.left_out_predictions(), strict=True))
    used = [i for i, agrees in enumerate(before.agreeing) if agrees]
    tasks = [(before.stored[i], poses[i], before.change) for i in used]
    return [(first, second) for first, second in before.setup.run(predicted_task, tasks)]


_LEAST_AGREEING = 0.7  # of the frames, from which on others are predicted from them


def predict_from_first(
    first: Sequence[SessionFrame], others: Mapping[str, Mapping[str, float]], setup: ArmSetup
) -> dict[str, Posed]:
    """Predict frames of a recording from the modes of its ``first`` frames, in the order they were taken.

    Parameters
    ----------
    first
        Frames that were estimated by themselves.
    others
        The readings of the frames to predict, by name, rad and m.
    setup
        The recording's instrument, arm, settings and all readings.

    Returns
    -------
    dict of str to Posed
        The root's pose in the reference camera and the joints, by name; without the frames that have no readings of
        all outer joints at the time of their image less the lag. Empty if the first frames do not agree.
    """
    usable = [frame for frame in first if not frame.lacks]
    try:
        arm = initialised(started([ArmSession.of(setup, usable)])[0])
    except InputError:  # too few frames, or they contradict each other: then they tell nothing about the others
        return {}
    misfit = arm.solution.misfit / (6 + len(setup.instrument.joint_names))
    if float((misfit < INLIER_MISFIT).mean()) < _LEAST_AGREEING:
        return {}
    lag, series = arm.lag.applied, setup.series
    readings = {
        name: own if lag is None or series is None or name not in series.frames else series.of_frame(name, lag)
        for name, own in others.items()
    }
    names = [name for name, own in readings.items() if not np.isnan(outer_readings([own])).any()]
    if not names:
        return {}
    endoscope = arm.model.endoscope
    if isinstance(endoscope, Pieces):
        return {}  # in which piece the others are is not known yet
    if isinstance(endoscope, Steered):
        endoscope = endoscope.at(ecm_readings([readings[name] for name in names]))
    read = [readings[name] for name in names]
    model = SessionModel.of(read, setup.instrument, setup.config, setup.arm, endoscope)
    predicted = model.predict(arm.solution.calibration)
    return {name: predicted[i] for i, name in enumerate(names)}
