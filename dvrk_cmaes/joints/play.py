"""Play of cable-driven joints: how far a joint stays behind its reading, given all readings before.

The joint stands still while its reading moves within a band of half width ``width`` around it, and is dragged along by
the end of the band otherwise (the play, or backlash, operator). Two such bands are used for each joint, one of a third
of the width of the other, because a cable gives way before it slips.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes.geometry import Float64

NARROW: Final = 1 / 3
"""Width of the narrow band, relative to the wide one."""


@dataclass(frozen=True, eq=False)
class Play:
    """How far C joints stay behind their readings, rad: ``wide`` and ``narrow`` (..., C), for the two bands."""

    wide: Float64
    narrow: Float64


def play_of(readings: Float64, width: Float64) -> Play:
    """Return the play (N, C) at N readings (N, C), rad, in the order of time; ``width`` (C,), rad."""
    places = [
        np.stack([_places(column, factor * band) for column, band in zip(readings.T, width, strict=True)], axis=1)
        for factor in (1.0, NARROW)
    ]
    return Play(*(np.nan_to_num(place - readings) for place in places))


def _places(readings: Float64, width: float) -> Float64:
    """Return the place (N,) of one joint within its play at each of N readings, NaN before the first."""
    found, place = [], float("nan")
    for reading in readings.tolist():
        if place != place:  # not known yet
            place = reading
        elif reading == reading:
            place = min(max(place, reading - width), reading + width)
        found.append(place)
    return np.array(found)


def play_between(
    times: Float64, values: Float64, width: float, at: Float64, readings: Float64
) -> tuple[Float64, Float64]:
    """Return how far one joint stays behind (N,), in the wide and in the narrow band, at readings between known ones.

    ``values`` (M,), rad, at increasing ``times`` (M,) are all readings that are known, ``readings`` (N,) those at the
    times ``at`` (N,); zero before the first reading and where there is none.
    """
    found = []
    for band in (width, NARROW * width):
        before = np.searchsorted(times, at, side="right") - 1
        place = np.where(before < 0, readings, _places(values, band)[np.maximum(before, 0)])
        found.append(np.nan_to_num(np.clip(place, readings - band, readings + band) - readings))
    return found[0], found[1]
