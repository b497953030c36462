"""Motion of joints whose cables stretch, couple and slip as those of a real arm: true positions for given readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.joints.cable_prior import CableModel, Play, cable_prior, measured_cables, play_of

_UNMEASURED: Final = 1 / 3
"""Couplings of joints that were not measured, relative to the standard deviation that is assumed of them."""


def draw_cables(names: Sequence[str], offset_std: Float64, rng: np.random.Generator) -> CableModel:
    """Draw the cables of an arm: one of the fits to real recordings, with offsets of a standard deviation (C,), rad.

    The coupling of joints that were not measured, such as the jaw, is drawn, too.
    """
    fits = measured_cables(tuple(names))
    model, count = fits[int(rng.integers(len(fits)))], len(names)
    drawn = _UNMEASURED * cable_prior(tuple(names)).spread[:, :count] * rng.standard_normal((count, count))
    coupling = np.where(model.coupling == 0, drawn, model.coupling)
    return replace(model, offset=offset_std * rng.standard_normal(count), coupling=coupling)


def pulled(
    paths: Mapping[str, Float64], model: CableModel, interval: float, rng: np.random.Generator
) -> dict[str, Float64]:
    """Return the true positions (N,) of a model's joints, rad, by name, whose readings (N,) are ``paths``.

    The offsets are left out, and coupling is zero in the middle of the paths. Readings are ``interval`` s apart. Before
    the first, the joints have moved as they do after it, so that they start anywhere within their play.
    """
    readings = np.stack([paths[name] for name in model.names], axis=1)
    both = play_of(np.concatenate([readings[::-1], readings]), model.width)
    play = Play(both.wide[len(readings) :], both.narrow[len(readings) :])
    count = len(model.names)
    here = replace(model, offset=np.zeros(count), reference=readings.mean(axis=0))
    errors = here.errors(readings, play) + _wander(len(readings), model, interval, rng)
    errors += model.noise * rng.standard_normal(errors.shape)
    return {name: readings[:, k] + errors[:, k] for k, name in enumerate(model.names)}


def _wander(count: int, model: CableModel, interval: float, rng: np.random.Generator) -> Float64:
    """Draw Ornstein-Uhlenbeck processes (count, C), rad."""
    keep = np.exp(-interval / model.seconds)
    value = model.wander * rng.standard_normal(len(keep))
    values = []
    for _ in range(count):
        values.append(value)
        value = keep * value + model.wander * np.sqrt(1 - keep**2) * rng.standard_normal(len(keep))
    return np.array(values)
