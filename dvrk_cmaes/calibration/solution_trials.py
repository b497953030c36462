"""Several solutions of one session, of which that one is taken that predicts frames best which are left out.

A session is solved at several lags where its frames' own modes do not tell the lag, and again with masks that were
found around its silhouettes. Errors of cables and a lag explain much of each other in the frames that are fitted; in
frames that are left out, they do not.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.alternation import (
    initialised,
    solved,
    with_lag_of_fits,
    with_lag_of_modes,
    with_other_masks,
)
from dvrk_cmaes.calibration.endoscope import Pieces, Place
from dvrk_cmaes.calibration.endoscope_search import LEAST_PIECE, with_pieces, with_readings
from dvrk_cmaes.calibration.lag_search import UNLIKELY, LagCurve
from dvrk_cmaes.calibration.lasting_errors import CORRELATED_FRAMES
from dvrk_cmaes.calibration.masks_again import (
    FoundAgain,
    again_task,
    compared,
    predicted_task,
)
from dvrk_cmaes.calibration.session_state import FoundMasks, SessionState
from dvrk_cmaes.errors import InputError

MOST_LAGS: Final = 3
"""Largest number of lags at which a session is solved, beside none."""

_CLEAR = 2.0  # standard deviations of a mean difference, and ...
_LEAST_GAIN = 0.005  # ... of overlap, by which a lag must predict better than none
_MOVED_SHARE = 0.1  # of the frames, that agree only if the session is cut where its base moved
_WELL = 0.06  # of overlap, by which left-out frames may be worse than their own fits for the session to predict well


def solve_session(start: SessionState, places: Sequence[Place] = ()) -> SessionState:
    """Solve a session; one that is cut into pieces between which the base moved is also solved in one.

    Frames near each other in time, whose masks err alike, agree with each other whatever they show. So a session stays
    cut only if that explains clearly more frames.

    Parameters
    ----------
    start
        The session, of which nothing is solved yet.
    places
        Those at which the endoscope stands, where they are known.

    Raises
    ------
    InputError
        As `initialised`.
    """
    session = _solved_at_its_lag(start, places)
    if not isinstance(session.model.endoscope, Pieces):
        return session
    try:
        whole = _solved_at_its_lag(replace(start, problem=replace(start.problem, may_cut=False)), places)
    except InputError:
        return session
    gain = sum(session.agreeing) - sum(whole.agreeing)
    return session if gain >= max(LEAST_PIECE, _MOVED_SHARE * len(session.frames)) else whole


def _solved_at_its_lag(start: SessionState, places: Sequence[Place]) -> SessionState:
    """Solve a session; where the frames' own modes do not tell the lag, also at others; arguments as `solve_session`.

    These are the lags that the modes allow and the one that the fits without a lag tell. A solution at such a lag is
    taken where it predicts frames that are left out clearly better than that without; else the fits may tell that there
    is no lag. Where the frames' own modes agree at no lag, such a solution must also predict well: the best of wrong
    ones predicts better than the others by chance. Where they agree about as well at several lags, as those of motions
    that repeat themselves, the one must predict clearly better than none and than the others, or none is taken out.
    """
    start = with_pieces_if_lost(with_lag_of_modes(with_readings(start, places)))
    several = bool(start.lag.rivals)
    if several:
        start = replace(start, lag=start.lag.with_rivals())
    lags = lags_to_try(start.lag.curve) if start.lag.can_be_tried else []
    try:
        session = solved(initialised(start))
    except InputError:
        trials = _at_lags(start, lags)
        if not trials:
            raise
        overlaps = [_left_out_overlaps(trial) for trial in trials]
        return trials[int(np.argmax([np.mean(list(each.values())) for each in overlaps]))]
    if not session.lag.can_be_tried:
        return session
    session, by_fits = (session, None) if several else with_lag_of_fits(session)
    without_lag = _left_out_overlaps(session)
    if by_fits is None and session.lag.lag is not None and _predicts_well(session, without_lag):
        return session
    trials = _at_lags(start, lags if by_fits is None else [by_fits, *lags])
    overlaps = [_left_out_overlaps(trial) for trial in trials]
    best = best_predicting(without_lag, overlaps)
    if best is None or (session.lag.nowhere and not _predicts_well(trials[best], overlaps[best])):
        return session
    if several and any(
        _apart(trials[best], trial) and best_predicting(others, [overlaps[best]]) is None
        for trial, others in zip(trials, overlaps, strict=True)
    ):
        return session
    return trials[best]


def _apart(one: SessionState, other: SessionState) -> bool:
    """Whether the lags of two solutions differ by more than a frame."""
    lags = [state.lag.applied for state in (one, other)]
    first, second = (0.0 if lag is None or lag.frames is None else lag.frames for lag in lags)
    return abs(first - second) > 1.0


def with_pieces_if_lost(start: SessionState) -> SessionState:
    """Return a session whose frames agree at no lag in pieces, if they agree at a lag so: its base may have moved.

    Parameters
    ----------
    start
        The session, whose lag was searched.
    """
    if not start.lag.nowhere or start.model.endoscope is not None:
        return start
    cut = with_pieces(start)
    if cut is None:
        return start
    again = with_lag_of_modes(cut)
    return start if again.lag.nowhere else again


def lags_to_try(curve: LagCurve | None) -> list[float]:
    """Return the lags, in the curve's unit, at which the frames' modes disagree least, the best first; without zero.

    They are the minima of the curve between its ends that are not much higher than its lowest point.
    """
    if curve is None or len(curve.lags) < 3:
        return []
    misfit = curve.misfit
    inner = np.arange(1, len(misfit) - 1)
    minima = inner[(misfit[inner] <= misfit[inner - 1]) & (misfit[inner] <= misfit[inner + 1])]
    step = float(np.diff(curve.lags).min())
    order = minima[np.argsort(misfit[minima], kind="stable")]
    likely = [k for k in order if misfit[k] <= UNLIKELY * misfit.min()]
    return [float(curve.lags[k]) for k in likely if abs(curve.lags[k]) > 0.5 * step][:MOST_LAGS]


def best_predicting(first: Mapping[str, float], others: Sequence[Mapping[str, float]]) -> int | None:
    """Return which of several solutions predicts the frames best, or None if none is clearly better than the first.

    Parameters
    ----------
    first, others
        Overlap of each frame's mask and the silhouette that the other frames predict, by the frame's name.
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


def with_masks_again(session: SessionState) -> SessionState:
    """Find the masks again that were found in images, around the fits, and solve again; returns the better solution.

    Only frames that agree with the session are looked at again, and only those whose masks change are fitted again.
    ``again`` of the returned one tells what was compared; it is None, and the given one is returned, without such
    frames.

    Parameters
    ----------
    session
        The session, solved.
    """
    agree, problem, change = session.agreeing, session.problem, session.imaging.change
    finders = {i: frame.find_masks for i, frame in enumerate(session.frames) if agree[i]}
    tasks = {
        i: (session.frames[i].data, find, session.fits[i].at, change) for i, find in finders.items() if find is not None
    }
    if not tasks:
        return session
    problem.progress("finding masks again", len(tasks))
    found: dict[int, FoundAgain] = dict(zip(tasks, problem.run(again_task, list(tasks.values())), strict=True))
    new = {i: of_frame.masks for i, of_frame in found.items() if of_frame.masks}
    other = with_other_masks(session, new) if new else session
    pairs = zip(session.left_out_predictions(), other.left_out_predictions(), strict=True)
    poses = list(pairs)
    used = [i for i, agrees in enumerate(agree) if agrees]
    predicted = problem.run(predicted_task, [(session.stored[i], poses[i], change) for i in used])
    bases = (session.solution.calibration.camera_from_base, other.solution.calibration.camera_from_base)
    again = compared([of_frame.iou for of_frame in found.values()], len(new), bases, predicted)
    better = other if again.applied else session
    return replace(better, again=replace(better.again or FoundMasks(), compared=again))


def _at_lags(start: SessionState, lags: Sequence[float]) -> list[SessionState]:
    """Solve a session at some lags, but for those that its readings contradict."""
    trials = []
    for lag in lags:
        start.problem.progress("trying another lag", len(start.frames))
        with contextlib.suppress(InputError):
            trials.append(solved(initialised(replace(start, lag=start.lag.with_trial(lag)))))
    return trials


def _left_out_overlaps(session: SessionState) -> dict[str, float]:
    """Return the overlap of each frame's masks and the silhouette that all other frames predict, by its name."""
    pairs = zip(session.stored, session.left_out_predictions(), strict=True)
    tasks = [(stored, [at], session.imaging.change) for stored, at in pairs]
    measured = session.problem.run(predicted_task, tasks)
    return {frame.name: iou for frame, ((iou, _),) in zip(session.frames, measured, strict=True)}


def _predicts_well(session: SessionState, left_out: Mapping[str, float]) -> bool:
    """Whether frames that are left out overlap nearly as well as their fits; argument as of `_left_out_overlaps`."""
    return float(np.median(list(left_out.values()))) > float(np.median([fit.iou for fit in session.fits])) - _WELL
