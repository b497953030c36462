"""Detection of faults that concern a session as a whole, from its frames' modes.

Faults are: an arm that does not move, a base or camera that moved during the session, and readings of another arm or
tool. The lag between images and readings is estimated in `dvrk_cmaes.calibration.lag`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.consensus import Consensus, Mode, find_consensus
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET, ROLL_OFFSET, ROLL_OFFSET_LONG

Float64 = NDArray[np.float64]

_STILL_RAD, _STILL_M = np.deg2rad(0.05), 2e-4  # standard deviation below which readings are constant
_IMPROVEMENT = 0.5  # largest ratio of mean misfits at which another explanation replaces the first
_GOOD_MISFIT = 0.5  # mean misfit at which no other explanation is needed
_LEAST_GROUP = 3  # frames that must agree on another base
_AGREEING_SHARE = 0.6  # of the frames off the consensus that must agree on another base


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


@dataclass(frozen=True)
class Move:
    """A move of the base or camera during the session.

    ``between`` are the indices of the last frame that agrees on one base and the first that agrees on the other;
    ``side`` is the part of the session to calibrate, ``first`` or ``last``; ``others`` are the indices of the frames in
    the other part.
    """

    between: tuple[int, int]
    side: str
    others: tuple[int, ...]


def find_move(
    model: SessionModel, modes: Sequence[Sequence[Mode]], offset_std: Float64, consensus: Consensus
) -> Move | None:
    """Find a move of the base: frames off the consensus that agree on another base, all before or all after the others.

    Parameters
    ----------
    model, modes, offset_std
        As in `find_consensus`.
    consensus
        The consensus of all frames.
    """
    disagreeing = np.flatnonzero(~consensus.agree).tolist()
    if len(disagreeing) < _LEAST_GROUP:
        return None
    second = find_consensus(model.subset(disagreeing), [modes[i] for i in disagreeing], offset_std)
    second_group = np.array(disagreeing)[second.agree]
    if len(second_group) < max(_LEAST_GROUP, _AGREEING_SHARE * len(disagreeing)):
        return None
    first_group = np.flatnonzero(consensus.agree)
    for earlier, later, side in ((first_group, second_group, "first"), (second_group, first_group, "last")):
        if earlier.max() < later.min():
            others = tuple(int(i) for i in range(len(modes)) if (i >= later.min()) == (side == "first"))
            return Move((int(earlier.max()), int(later.min())), side, others)
    return None


def check_arm(model: SessionModel, modes: Sequence[Sequence[Mode]], offset_std: Float64, consensus: Consensus) -> None:
    """Refuse readings that only fit with the length of another arm or tool.

    Parameters
    ----------
    model, modes, offset_std
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
        other = find_consensus(replace(model, outer=outer), modes, offset_std)
        if other.mean_misfit < _IMPROVEMENT * misfit:
            than = "longer" if difference > 0 else "shorter"
            raise InputError(
                f"session: the readings fit an arm or tool {abs(difference) * 1e3:.0f} mm {than}"
                ": expected --arm, or the tool's own roll joint (--tool), to be the recorded one's"
            )
