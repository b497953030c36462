"""Detection of faults that concern a session as a whole, from its frames' modes.

Faults are: an arm that does not move, and readings of another arm or tool. A base or camera that moved is found in
`dvrk_cmaes.calibration.endoscope_search`, the lag between images and readings in `dvrk_cmaes.calibration.lag_search`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dvrk_cmaes.calibration.consensus import Consensus, Mode, find_consensus
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET, ROLL_OFFSET, ROLL_OFFSET_LONG

_STILL_RAD, _STILL_M = np.deg2rad(0.05), 2e-4  # standard deviation below which readings are constant
IMPROVEMENT = 0.5  # largest ratio of mean misfits at which another explanation replaces the first
_GOOD_MISFIT = 0.5  # mean misfit at which no other explanation is needed


def check_motion(model: SessionModel) -> None:
    """Refuse the readings of an arm that does not move, from which its base cannot be estimated.

    Raises
    ------
    InputError
        The readings of all outer joints are constant.
    """
    std = model.outer.std(axis=0)
    if (std[[0, 1, 3]] < _STILL_RAD).all() and std[2] < _STILL_M:
        raise InputError(
            "session: yaw, pitch, insertion, roll: expected readings of an arm that moves, got the same in all frames"
        )


def check_arm(model: SessionModel, modes: Sequence[Sequence[Mode]], consensus: Consensus) -> None:
    """Refuse readings that only fit with the length of another arm or tool.

    Parameters
    ----------
    model, modes
        As in `find_consensus`.
    consensus
        The consensus of all frames.

    Raises
    ------
    InputError
        The consensus is clearly better with another length; the message states the difference, mm.
    """
    differences = ROLL_OFFSET_LONG - ROLL_OFFSET, INSERTION_OFFSET["si"] - INSERTION_OFFSET["classic"]
    misfit = consensus.mean_misfit
    if misfit < _GOOD_MISFIT:
        return
    for difference in differences:
        outer = model.outer.copy()
        outer[:, 2] += difference
        other = find_consensus(replace(model, outer=outer), modes)
        if other.mean_misfit < IMPROVEMENT * misfit:
            than = "longer" if difference > 0 else "shorter"
            raise InputError(
                f"session: the readings fit an arm or tool {abs(difference) * 1e3:.0f} mm {than}"
                ": expected --arm, or the tool's own roll joint (--tool), to be the recorded one's"
            )
