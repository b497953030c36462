"""Errors of cable-driven joints as functions of their readings, and the prior of them for an arm's cables.

The prior are the fits to recordings of a real arm, and how far others may differ. The fits are in
data/cables/measured.json, which ``scripts/cables.py --write`` makes. They are of roll, wrist_pitch and wrist_yaw; any
other joint has the play of the wrist's joints, and a coupling of which only the size is known.

The errors are offset, coupling, play and wander. For C joints with readings r, in the order of time,

    true - reading = offset + coupling (r - reference) + play wide(r) + narrow * narrow(r) + wander + noise

``wide`` and ``narrow`` are how far the joints stay behind their readings, given all readings before. The diagonal of
``play`` is a joint's own; the rest is the drag of the other joints' cables, which run over the same pulleys. The wander
is an Ornstein-Uhlenbeck process.

A joint stands still while its reading moves within a band of half width ``width`` around it, and is dragged along by
the end of the band otherwise (the play, or backlash, operator). Two such bands are used for each joint, one of a
third of the width of the other, because a cable gives way before it slips.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.files import bundled_path
from dvrk_cmaes.io.json_file import read_json_object

_WRIST: Final = ("wrist_pitch", "wrist_yaw")
_OTHER_ARMS: Final = 0.5  # standard deviation of another arm's coefficient, relative to the mean of the fits,
_LEAST_SPREAD: Final = {"roll": 0.02}  # but at least this, rad a rad,
_WRIST_SPREAD: Final = 0.1  # or for the joints of the instrument this
_UNKNOWN_COUPLING: Final = 0.15  # rad a rad, standard deviation of a coupling that was not measured


@dataclass(frozen=True, eq=False)
class CablePrior:
    """What is expected of the cables of an arm before anything of it was measured.

    ``model`` has the expected values; its offsets and references are zero. ``spread`` (C, 2 C + 1) are the standard
    deviations of its coefficients from arm to arm, rad a rad.
    """

    model: CableModel
    spread: Float64


@cache
def measured_cables(names: tuple[str, ...]) -> tuple[CableModel, ...]:
    """Return the fits to the recordings, for some joints.

    A joint that was not measured has the mean play of the wrist's joints, no coupling and no drag.
    """
    document = read_json_object(bundled_path("cables", "measured.json"), expected="fits of cables")
    return tuple(_of_joints(fit, names) for fit in document["fits"])


@cache
def cable_prior(names: tuple[str, ...]) -> CablePrior:
    """Return what is expected of the cables of some joints."""
    fits = measured_cables(names)
    mean = _mean(fits)
    count = len(names)
    measured = np.array([name in ("roll", *_WRIST) for name in names])
    coefficients = np.array([fit.coefficients for fit in fits])
    least = np.array([_LEAST_SPREAD.get(name, _WRIST_SPREAD) for name in names])[:, None]
    spread = np.hypot(np.std(coefficients, axis=0), _OTHER_ARMS * coefficients.mean(axis=0))
    spread = np.maximum(spread, least)
    unknown = ~(measured[:, None] & measured[None])
    unknown[[name == "roll" for name in names]] = False  # nothing moves roll by much
    spread[:, :count][unknown] = _UNKNOWN_COUPLING
    return CablePrior(mean, spread)


def _mean(fits: Sequence[CableModel]) -> CableModel:
    """Return the mean of the fits' parameters, without offsets and references."""
    none = np.zeros(len(fits[0].names))
    means = {name: np.asarray(np.mean([getattr(fit, name) for fit in fits], axis=0)) for name in PARAMETERS}
    return CableModel(fits[0].names, offset=none, **means | {"reference": none})


def _of_joints(fit: Mapping[str, Any], names: tuple[str, ...]) -> CableModel:
    """Return a fit for some joints; it has lists by joint, and lists of lists for pairs of joints."""
    known: list[str] = fit["joints"]
    measured = np.array([name in known for name in names])
    places = [known.index(name) if name in known else 0 for name in names]
    wrist = [known.index(name) for name in _WRIST]
    arrays = {name: np.array(values) for name, values in fit.items()}

    def each(values: Float64) -> Float64:
        """Return values (C,) of the joints; for one that was not measured, the mean of the wrist's."""
        return np.where(measured, values[places], values[wrist].mean())

    def pairs(values: Float64, own: Float64) -> Float64:
        """Return values (C, C) of pairs of joints; of pairs that were not measured, the diagonal ``own`` (C,)."""
        return np.where(measured[:, None] & measured, values[np.ix_(places, places)], np.diag(own))

    none = np.zeros(len(names))
    return CableModel(
        names,
        reference=none,
        coupling=pairs(arrays["coupling"], none),
        play=pairs(arrays["play"], each(np.diag(arrays["play"]))),
        narrow=each(arrays["narrow"]),
        seconds=each(arrays["wander_seconds"]),
        **{name: np.deg2rad(each(arrays[f"{name}_deg"])) for name in ("offset", "width", "wander", "noise")},
    )


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
