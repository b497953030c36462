"""The start of a session: its lag, its endoscope and its pieces by the frames' own modes; then all are solved.

A session whose base seems to have moved is also solved in one piece, and stays cut where that explains more frames.
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
from dvrk_cmaes.calibration.lag import in_common
from dvrk_cmaes.calibration.model import SessionModel, ecm_readings, outer_readings
from dvrk_cmaes.calibration.session_frame import SessionFrame
from dvrk_cmaes.calibration.session_problem import (
    Arms,
    ArmSession,
    ArmSetup,
    initialised,
    solved,
)
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, Posed

_MOVED_SHARE = 0.1  # of the frames, that agree only if the session is cut where its base moved
_AGREE: Final = 4.0  # standard deviations of each unknown, within which arms find the same endoscope
_OTHER_TIP: Final = (
    "the arms show another camera in the endoscope's tip: each has its own; one arm's readings may be wrong"
)
_HAND_EYE: Final = 10  # unknowns that do not differ from place to place


def solve_session(arms: Arms) -> Arms:
    """Solve the arms of a session in one problem; one that is cut where the base moved is also solved in one piece.

    Frames near each other in time, whose masks err alike, agree with each other whatever they show. So a session stays
    cut only if that explains clearly more frames.

    Raises
    ------
    InputError
        As `session_problem.initialised` and `solved`.
    """
    session = _solved(arms)
    if any(isinstance(arm.model.endoscope, Pieces) for arm in session):
        with contextlib.suppress(InputError):
            whole = _solved([replace(arm, setup=replace(arm.setup, may_cut=False)) for arm in arms])
            gain = sum(one.agreeing - other.agreeing for one, other in zip(session, whole, strict=True))
            if gain < max(LEAST_PIECE, _MOVED_SHARE * sum(len(arm.frames) for arm in session)):
                session = whole
    return session


def _solved(arms: Arms) -> Arms:
    """Solve a session at the lag that its frames' own modes determine."""
    first, *others = [initialised(arm) for arm in started(arms)]
    return solved(_with_common_endoscope(first, others))


def started(arms: Arms) -> Arms:
    """Find the endoscope, and the lag by the modes of the frames."""
    found = list[ArmSession]()
    for arm in arms:
        first = found[0].model.endoscope if found else None
        arm = _with_readings(arm, first if isinstance(first, Steered) else None)
        found.append(replace(arm, lag=arm.lag.searched(arm.model, arm.modes)))
    common = in_common([arm.lag for arm in found])
    return [replace(arm, lag=lag) for arm, lag in zip(found, common, strict=True)]


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


def _with_common_endoscope(first: ArmSession, others: Arms) -> Arms:
    """Return arms of which those that find the endoscope of the first one share it.

    Of one that is not read, these are the moves of the camera between pieces, where the arms have the same pieces.
    """
    endoscope, own = first.model.endoscope, first.solution.calibration.endoscope
    if endoscope is None or own is None or not others:
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
    endoscope = replace(endoscope, start=known.start, loose=known.loose, shared=True)
    values = first.solution.calibration.endoscope
    calibration = arm.solution.calibration.with_blocks(endoscope.block, endoscope=values)
    return replace(
        arm, model=replace(arm.model, endoscope=endoscope), found=replace(arm.solution, calibration=calibration)
    )


def _of_endoscope(arm: ArmSession) -> Float64:
    """Return the covariance (M, M) of the endoscope's values that the frames of an arm show."""
    place = arm.solution.calibration.place("endoscope")
    return arm.solution.covariance[place, place]


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
    except InputError:  # too few frames, or they contradict each other: then they show nothing about the others
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
