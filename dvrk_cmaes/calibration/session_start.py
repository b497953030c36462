"""The start of a session: its endoscope and its lag by the frames' own modes; then all is solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import ENDOSCOPE
from dvrk_cmaes.calibration.consensus import INLIER_MISFIT, Consensus, Mode, evenly_spaced, find_consensus
from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.calibration.lag import in_common
from dvrk_cmaes.calibration.model import SessionModel, ecm_readings, outer_readings
from dvrk_cmaes.calibration.session_problem import (
    Arms,
    ArmSession,
    ArmSetup,
    initialised,
    solved,
)
from dvrk_cmaes.calibration.solve import solve_with_modes
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, Posed

_HYPOTHESIS_FRAMES, _TEST_FRAMES = 10, 60  # of each consensus of the search for the camera in the tip
_TRIED: Final = 4  # cameras in the tip by which the frames agree best, that are refined
_FOUND: Final = 0.3  # of the deviations beforehand: those of a refined camera in the tip
_AGREE: Final = 4.0  # standard deviations of each unknown, within which arms find the same endoscope
_OTHER_TIP: Final = (
    "the arms tell another camera in the endoscope's tip: each has its own; one arm's readings may be wrong"
)
_HAND_EYE: Final = 10  # unknowns that do not differ from place to place


def solve_session(arms: Arms) -> Arms:
    """Solve the arms of a session in one problem, at the lag that their frames' own modes determine.

    Raises
    ------
    InputError
        As `session_problem.initialised` and `solved`.
    """
    first, *others = [initialised(arm) for arm in started(arms)]
    return solved(_with_common_endoscope(first, others))


def started(arms: Arms) -> Arms:
    """Find the endoscope, and the lag by the modes of the frames."""
    found = list[ArmSession]()
    for arm in arms:
        arm = _with_readings(arm, found[0].model.endoscope if found else None)
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


def find_hand_eye(model: SessionModel, modes: Sequence[Sequence[Mode]], steered: Steered) -> Steered:
    """Find the camera in the endoscope's tip by which the frames' modes agree best, at any turn about the axis.

    Parameters
    ----------
    model, modes
        As in `find_consensus`.
    steered
        The endoscope in all frames, whose camera is not known yet.
    """
    few = evenly_spaced(len(modes), _TEST_FRAMES)
    modes = [modes[i] for i in few]
    model = replace(model, endoscope=steered).subset(few)
    tried: list[tuple[float, Steered, Consensus]] = []
    for offered in steered.hand_eyes():
        of_few = replace(model, endoscope=offered.subset(few))
        consensus = find_consensus(of_few, modes, hypothesis_frames=_HYPOTHESIS_FRAMES)
        tried.append((consensus.mean_misfit, offered, consensus))
    refined: list[tuple[float, Steered]] = []
    for _, offered, consensus in sorted(tried, key=lambda one: one[0])[:_TRIED]:
        of_few = replace(model, endoscope=offered.subset(few))
        solution = solve_with_modes(of_few, modes, consensus.calibration)
        values = solution.calibration.endoscope
        assert values is not None
        there = replace(offered, start=values, loose=_FOUND * offered.loose)
        of_few = replace(model, endoscope=there.subset(few))
        again = find_consensus(of_few, modes, hypothesis_frames=_HYPOTHESIS_FRAMES)
        refined.append((float(again.cost.mean()), there))
    return min(refined, key=lambda one: one[0])[1]


def _with_common_endoscope(first: ArmSession, others: Arms) -> Arms:
    """Return arms of which those that find the endoscope of the first one share it."""
    endoscope, own = first.model.endoscope, first.solution.calibration.endoscope
    if endoscope is None or own is None or not others:
        return [first, *others]
    first = _with_shared_endoscope(first, first)
    out = [first]
    for other in others:
        theirs = other.solution.calibration.endoscope
        if theirs is None or len(theirs.errors) != len(own.errors):
            out.append(other)
            continue
        apart = np.abs(own.deviation - replace(theirs, expected=own.expected).deviation)
        spread = np.sqrt(np.diag(_of_endoscope(first) + _of_endoscope(other)))
        agree = not (apart > _AGREE * spread)[:_HAND_EYE].any()
        if not agree:
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
    place = arm.solution.calibration.place(ENDOSCOPE)
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
    if endoscope is not None:
        endoscope = endoscope.at(ecm_readings([readings[name] for name in names]))
    read = [readings[name] for name in names]
    model = SessionModel.of(read, setup.instrument, setup.config, setup.arm, endoscope)
    predicted = model.predict(arm.solution.calibration)
    return {name: predicted[i] for i, name in enumerate(names)}
