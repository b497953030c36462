"""Errors of cable-driven joints as functions of their readings: offset, coupling, play and wander.

For C joints with readings r, in the order of time,

    true - reading = offset + coupling (r - reference) + play wide(r) + narrow * narrow(r) + wander + noise

``wide`` and ``narrow`` are how far the joints stay behind their readings, given all readings before. The diagonal of
``play`` is a joint's own; the rest is the drag of the other joints' cables, which run over the same pulleys. The wander
is an Ornstein-Uhlenbeck process.

A joint stands still while its reading moves within a band of half width ``width`` around it, and is dragged along by
the end of the band otherwise (the play, or backlash, operator). Two such bands are used for each joint, one of a
third of the width of the other, because a cable gives way before it slips.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes.geometry import Float64

PARAMETERS = ("reference", "coupling", "play", "narrow", "width", "wander", "seconds", "noise")
"""Fields of a `CableModel` but the names and the offset."""


@dataclass(frozen=True, eq=False)
class CableModel:
    """Parameters of the errors of C cable-driven joints; rad and seconds.

    names : of the joints. reference : (C,) readings at which coupling adds nothing. offset : (C,).
    coupling : (C, C), error of the joint of the row for each rad of the reading of the column.
    play : (C, C), error for each rad that the column's joint stays behind in the wide band; narrow : (C,), for each rad
    that the joint itself does in the narrow band. width : (C,) half width of the wide band.
    wander, seconds : (C,) standard deviation and correlation time of the wander. noise : (C,) standard deviation.
    """

    names: tuple[str, ...]
    reference: Float64
    offset: Float64
    coupling: Float64
    play: Float64
    narrow: Float64
    width: Float64
    wander: Float64
    seconds: Float64
    noise: Float64

    @property
    def coefficients(self) -> Float64:
        """Coefficients (C, 2 C + 1) of each joint's `features`."""
        return np.concatenate([self.coupling, self.play, self.narrow[:, None]], axis=1)

    def errors(self, readings: Float64, play: Play) -> Float64:
        """Return true - reading (N, C), without wander and noise, of readings (N, C) and the play there."""
        terms = features(readings, play, self.reference)
        return np.asarray(self.offset + np.einsum("ncf,cf->nc", terms, self.coefficients))


def features(readings: Float64, play: Play, reference: Float64) -> Float64:
    """Return what the coefficients of each joint multiply, (N, C, 2 C + 1).

    These are the readings (N, C) less ``reference`` (C,), how far all joints stay behind in the wide band, and the
    joint itself in the narrow band; zero where there is no reading.
    """
    count = readings.shape[1]
    shared = np.concatenate([np.nan_to_num(readings - reference), play.wide], axis=1)
    return np.concatenate([np.repeat(shared[:, None], count, axis=1), play.narrow[:, :, None]], axis=2)


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
