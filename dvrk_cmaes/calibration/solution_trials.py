"""Several solutions of one session, of which that one is taken that predicts frames best which are left out.

A session is solved at several lags where its frames' own modes do not tell the lag, and again with masks that were
found around its silhouettes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence

import numpy as np

from dvrk_cmaes.calibration.alternation import Alternation
from dvrk_cmaes.calibration.lag_trials import best_predicting, lags_to_try
from dvrk_cmaes.calibration.masks_again import (
    AgainTask,
    FoundAgain,
    PredictedTask,
    again_task,
    compared,
    predicted_task,
)
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Posed

_WELL = 0.06  # of overlap, by which left-out frames may be worse than their own fits for the session to predict well


def solve_session(session: Alternation) -> Alternation:
    """Solve a session; where the frames' own modes do not tell the lag, also at others.

    These are the lags that the modes allow and the one that the fits without a lag tell. A solution at such a lag is
    taken where it predicts frames that are left out clearly better than that without; else the fits may tell that there
    is no lag. Where the frames' own modes agree at no lag, such a solution must also predict well: the best of wrong
    ones predicts better than the others by chance.

    Parameters
    ----------
    session
        The session, of which nothing is solved yet.

    Raises
    ------
    InputError
        As `Alternation.initialise`.
    """
    problem: InputError | None = None
    try:
        session.initialise()
        session.iterate()
    except InputError as error:
        problem = error
    if not session.lag.can_be_tried:
        if problem is not None:
            raise problem
        return session
    lags = lags_to_try(session.lag.curve)
    if problem is not None:
        trials = _at_lags(session, lags)
        if not trials:
            raise problem
        overlaps = [_left_out_overlaps(trial) for trial in trials]
        return trials[int(np.argmax([np.mean(list(each.values())) for each in overlaps]))]
    by_fits, without_lag = session.tell_lag(), _left_out_overlaps(session)
    if by_fits is None and session.lag.lag is not None and _predicts_well(session, without_lag):
        return session
    trials = _at_lags(session, lags if by_fits is None else [by_fits, *lags])
    overlaps = [_left_out_overlaps(trial) for trial in trials]
    best = best_predicting(without_lag, overlaps)
    if best is None or (session.lag.nowhere and not _predicts_well(trials[best], overlaps[best])):
        return session
    return trials[best]


def with_masks_again(session: Alternation) -> Alternation:
    """Find the masks again that were found in images, around the fits, and solve again; returns the better solution.

    Only frames that agree with the session are looked at again, and only those whose masks change are fitted again.
    ``again`` of the returned one tells what was compared; it is None, and the given one is returned, without such
    frames.

    Parameters
    ----------
    session
        The session, solved.
    """
    agree = session.agreeing
    finders = {i: frame.find_masks for i, frame in enumerate(session.frames) if agree[i]}
    tasks = {
        i: AgainTask(session.frames[i].data, find, session.fits[i].at, session.change)
        for i, find in finders.items()
        if find is not None
    }
    if not tasks:
        return session
    session.progress("finding masks again", len(tasks))
    found: dict[int, FoundAgain] = dict(zip(tasks, session.run(again_task, list(tasks.values())), strict=True))
    new = {i: of_frame.masks for i, of_frame in found.items() if of_frame.masks}
    other = session.with_masks(new) if new else session
    pairs = zip(session.left_out_predictions(), other.left_out_predictions(), strict=True)
    poses = [Posed.stacked(pair) for pair in pairs]
    used = [i for i, agrees in enumerate(agree) if agrees]
    predicted = session.run(predicted_task, [PredictedTask(session.stored[i], poses[i], session.change) for i in used])
    bases = (session.solution.calibration.camera_from_base, other.solution.calibration.camera_from_base)
    again = compared([of_frame.iou for of_frame in found.values()], len(new), bases, predicted)
    better = other if again.applied else session
    better.again = again
    return better


def _at_lags(session: Alternation, lags: Sequence[float]) -> list[Alternation]:
    """Solve a session at some lags, but for those that its readings contradict."""
    trials = []
    for lag in lags:
        session.progress("trying another lag", len(session.frames))
        with contextlib.suppress(InputError):
            trials.append(session.at_lag(lag))
    return trials


def _left_out_overlaps(session: Alternation) -> dict[str, float]:
    """Return the overlap of each frame's masks and the silhouette that all other frames predict, by its name."""
    poses = [Posed.stacked([at]) for at in session.left_out_predictions()]
    tasks = [PredictedTask(*pair, session.change) for pair in zip(session.stored, poses, strict=True)]
    measured = session.run(predicted_task, tasks)
    return {frame.name: iou for frame, ((iou, _),) in zip(session.frames, measured, strict=True)}


def _predicts_well(session: Alternation, left_out: Mapping[str, float]) -> bool:
    """Whether frames that are left out overlap nearly as well as their fits; argument as of `_left_out_overlaps`."""
    return float(np.median(list(left_out.values()))) > float(np.median([fit.iou for fit in session.fits])) - _WELL
