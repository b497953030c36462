"""What is expected of the cables of an arm: the fits to recordings of a real one, and how far others may differ.

The fits are in data/cables/measured.json, which ``scripts/cables.py --write`` makes. They are of roll, wrist_pitch and
wrist_yaw; any other joint has the play of the wrist's joints, and a coupling of which only the size is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from msgspec import Struct

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.typed_document import convert_document
from dvrk_cmaes.joints.cables import PARAMETERS, CableModel

_WRIST: Final = ("wrist_pitch", "wrist_yaw")
_OTHER_ARMS: Final = 0.5  # standard deviation of another arm's coefficient, relative to the mean of the fits,
_LEAST_SPREAD: Final = {"roll": 0.02}  # but at least this, rad a rad,
_WRIST_SPREAD: Final = 0.1  # or for the joints of the instrument this
_UNKNOWN_COUPLING: Final = 0.15  # rad a rad, standard deviation of a coupling that was not measured


class _Fit(Struct):
    """A fit of the model to a recording; lists by joint."""

    joints: tuple[str, ...]
    offset_deg: list[float]
    coupling: list[list[float]]
    play: list[list[float]]
    narrow: list[float]
    width_deg: list[float]
    wander_deg: list[float]
    wander_seconds: list[float]
    noise_deg: list[float]


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
    path = bundled_path("cables", "measured.json")
    document = read_json_object(path, expected="fits of cables")
    return tuple(
        _of_joints(fit, names) for fit in convert_document(str(path), document, dict[str, tuple[_Fit, ...]])["fits"]
    )


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


def _of_joints(fit: _Fit, names: tuple[str, ...]) -> CableModel:
    """Return a fit for some joints."""
    rows = {name: fit.joints.index(name) for name in fit.joints}
    wrist = [rows[name] for name in _WRIST]

    def each(values: list[float]) -> Float64:
        """Return values (C,) of the joints; for one that was not measured, the mean of the wrist's."""
        common = float(np.mean([values[k] for k in wrist]))
        return np.array([values[rows[name]] if name in rows else common for name in names])

    def pairs(values: list[list[float]], own: Float64) -> Float64:
        """Return values (C, C) of pairs of joints; of pairs that were not measured, the diagonal ``own`` (C,)."""
        matrix = np.diag(own)
        for j, name in enumerate(names):
            for k, other in enumerate(names):
                if name in rows and other in rows:
                    matrix[j, k] = values[rows[name]][rows[other]]
        return matrix

    own_play = each([fit.play[k][k] for k in range(len(fit.joints))])
    return CableModel(
        names,
        np.zeros(len(names)),
        np.deg2rad(each(fit.offset_deg)),
        pairs(fit.coupling, np.zeros(len(names))),
        pairs(fit.play, own_play),
        each(fit.narrow),
        np.deg2rad(each(fit.width_deg)),
        np.deg2rad(each(fit.wander_deg)),
        each(fit.wander_seconds),
        np.deg2rad(each(fit.noise_deg)),
    )
