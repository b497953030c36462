"""Where the frames of a recording are expected, from a few of them that were estimated by themselves.

The modes of those few agree on a camera_from_base and a lag, which is enough to start the others near their answer
instead of searching for them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dvrk_cmaes.calibration.alternation import initialised, with_lag_of_modes
from dvrk_cmaes.calibration.consensus import INLIER_MISFIT
from dvrk_cmaes.calibration.endoscope import Pieces, Steered
from dvrk_cmaes.calibration.endoscope_search import with_readings
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.calibration.model import SessionModel, ecm_readings, outer_readings
from dvrk_cmaes.calibration.session_state import SessionProblem, SessionState
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Posed

_LEAST_AGREEING = 0.7  # of the frames, from which on others are predicted from them


def predict_from_first(
    first: Sequence[SessionFrame], others: Mapping[str, Mapping[str, float]], problem: SessionProblem
) -> dict[str, Posed]:
    """Predict frames of a recording from the modes of its ``first`` frames, in the order they were taken.

    Parameters
    ----------
    first
        Frames that were estimated by themselves.
    others
        The readings of the frames to predict, by name, rad and m.
    problem
        The recording's instrument, arm, settings and all readings.

    Returns
    -------
    dict of str to Posed
        The root's pose in the reference camera and the joints, by name; without the frames that have no readings of
        all outer joints at the time of their image less the lag. Empty if the first frames do not agree.
    """
    usable = [frame for frame in first if not frame.lacks]
    try:
        state = initialised(with_lag_of_modes(with_readings(SessionState.of(problem, usable))))
    except InputError:  # too few frames, or they contradict each other: then they tell nothing about the others
        return {}
    misfit = state.solution.misfit / (6 + len(problem.instrument.joint_names))
    if float((misfit < INLIER_MISFIT).mean()) < _LEAST_AGREEING:
        return {}
    lag, series = state.lag.applied, problem.series
    readings = {
        name: own if lag is None or series is None or name not in series.frames else series.of_frame(name, lag)
        for name, own in others.items()
    }
    names = [name for name, own in readings.items() if not np.isnan(outer_readings([own])).any()]
    if not names:
        return {}
    endoscope = state.model.endoscope
    if isinstance(endoscope, Pieces):
        return {}  # in which piece the others are is not known yet
    if isinstance(endoscope, Steered):
        endoscope = endoscope.at(ecm_readings([readings[name] for name in names]))
    read = [readings[name] for name in names]
    model = SessionModel.of(read, problem.instrument, problem.config, problem.arm, endoscope)
    predicted = model.predict(state.solution.calibration)
    return {name: predicted[i] for i, name in enumerate(names)}
