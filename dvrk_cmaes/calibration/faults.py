"""What can be wrong with a whole session, found from its frames' modes before their images are looked at again.

A lag between readings and images, a base or camera that moved half way, the wrong arm or tool, an arm that stood still:
each is named, and never averaged over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.consensus import CAP, Consensus, Mode, find_consensus
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET, ROLL_OFFSET, ROLL_OFFSET_LONG

Float64 = NDArray[np.float64]

_STILL_RAD, _STILL_M = np.deg2rad(0.05), 2e-4  # spread below which readings are constant
_LAGS = (-3, -2, -1, 1, 2, 3)  # frames
_LAG_FRAMES = 6  # below which a lag cannot be told from bad frames
_CLEARLY = 0.5  # of the misfit as it is: what another explanation may leave
_LEAST_GROUP = 3  # frames that agree on another base


def check_motion(model: SessionModel) -> None:
    """Refuse an arm that stood still: readings that are all the same say nothing about its base."""
    spread = model.outer.std(axis=0)
    if (spread[[0, 1, 3]] < _STILL_RAD).all() and spread[2] < _STILL_M:
        raise InputError(
            "session: yaw, pitch, insertion, roll: expected readings of an arm that moves, got the same in all frames"
        )


def shifted(model: SessionModel, lag: int) -> tuple[SessionModel, list[int]]:
    """Return the model of readings that came ``lag`` frames late, and the frames that still have some."""
    count = len(model.outer)
    kept = [i for i in range(count) if 0 <= i + lag < count]
    later = [i + lag for i in kept]
    return model.of_readings(model.outer[later], model.joints[later]), kept


def _left_over(consensus: Consensus) -> float:
    """Mean misfit of a consensus, other modes capped."""
    return float(np.minimum(consensus.misfit, CAP).mean())


def find_lag(model: SessionModel, modes: Sequence[Sequence[Mode]], offset_spread: Float64) -> int:
    """Find by how many frames readings are late: 0 unless that explains the frames clearly better.

    Clearly: it leaves half of the misfit, or twice as large a share of the frames agree. Frames that were estimated
    with the readings of others may well be in wrong modes, so that not all of them will agree whatever the lag.
    """
    if len(modes) < _LAG_FRAMES:
        return 0
    consensus = find_consensus(model, modes, offset_spread)
    now, share = _left_over(consensus), float(consensus.agree.mean())
    best, least = 0, now
    for lag in _LAGS:
        other, kept = shifted(model, lag)
        if len(kept) < _LEAST_GROUP + 1:
            continue
        consensus = find_consensus(other, [modes[i] for i in kept], offset_spread)
        found, agree = _left_over(consensus), consensus.agree
        better = found < _CLEARLY * now or (agree.sum() >= _LEAST_GROUP and agree.mean() * _CLEARLY >= share)
        if better and found < least:
            best, least = lag, found
    return best if now > _CLEARLY else 0


@dataclass(frozen=True)
class Move:
    """Two bases: the frames between which it moved, the side that is kept, and the ``others``, by their place."""

    between: tuple[int, int]
    side: str
    others: tuple[int, ...]


def find_move(
    model: SessionModel, modes: Sequence[Sequence[Mode]], offset_spread: Float64, consensus: Consensus
) -> Move | None:
    """Find out whether the frames that disagree are all before or all after the others, and agree among themselves."""
    away = np.flatnonzero(~consensus.agree).tolist()
    if len(away) < _LEAST_GROUP:
        return None
    second = find_consensus(model.subset(away), [modes[i] for i in away], offset_spread)
    theirs = np.array(away)[second.agree]
    if len(theirs) < max(_LEAST_GROUP, 0.6 * len(away)):
        return None
    ours = np.flatnonzero(consensus.agree)
    for first, last, side in ((ours, theirs, "first"), (theirs, ours, "last")):
        if first.max() < last.min():
            gone = tuple(int(i) for i in range(len(modes)) if (i >= last.min()) == (side == "first"))
            return Move((int(first.max()), int(last.min())), side, gone)
    return None


def check_arm(
    model: SessionModel, modes: Sequence[Sequence[Mode]], offset_spread: Float64, consensus: Consensus
) -> None:
    """Refuse readings that only fit an arm or tool of another length."""
    longer = ROLL_OFFSET_LONG - ROLL_OFFSET, INSERTION_OFFSET["si"] - INSERTION_OFFSET["classic"]
    now = _left_over(consensus)
    if now < _CLEARLY:
        return
    for shift in longer:
        outer = model.outer.copy()
        outer[:, 2] += shift
        other = find_consensus(model.of_readings(outer, model.joints), modes, offset_spread)
        if _left_over(other) < _CLEARLY * now:
            than = "longer" if shift > 0 else "shorter"
            raise InputError(
                f"session: the readings fit an arm or tool {abs(shift) * 1e3:.0f} mm {than}"
                ": expected --arm, or the tool's own roll joint (--tool), to be the recorded one's"
            )
