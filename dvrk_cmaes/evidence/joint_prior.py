"""One frame's joint readings, sorted: what is known of the joints that are sought, and what to say about the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm

Float64 = NDArray[np.float64]


LIMIT_SPREAD = float(np.deg2rad(3.0))
"""How far beyond its limits a joint may be by one standard deviation, rad."""


def reading_loss(joints: Float64, readings: Float64, spread: Float64) -> Float64:
    """Squared deviation of joints (..., J) from the readings in units of their spread; a reading of NaN is unknown."""
    return np.asarray(np.nansum(((joints - readings) / spread) ** 2, axis=-1))


@dataclass(frozen=True, eq=False)
class Readings:
    """What is known of the joints without looking: readings and limits.

    ``values`` (J,), NaN where unknown, with standard deviations ``spread`` (J,); ``low`` and ``high`` (J,) bound what
    the joints can be, softly. All in rad.
    """

    values: Float64
    spread: Float64
    low: Float64
    high: Float64

    def cost(self, joints: Float64) -> Float64:
        """Sum of squared deviations (...) of joints (..., J), in standard deviations, from readings and limits."""
        beyond = np.maximum(self.low - joints, 0) + np.maximum(joints - self.high, 0)
        outside = ((beyond / LIMIT_SPREAD) ** 2).sum(axis=-1)
        return np.asarray(reading_loss(joints, self.values, self.spread) + outside)


def split_readings(
    instrument: Instrument, joints: Mapping[str, float], config: EstimateConfig
) -> tuple[Readings, list[str], list[str]]:
    """Sort readings: those of the joints that are sought, what is unknown, warnings about values outside limits."""
    known = (*instrument.joint_names, *OUTER_JOINTS)
    for name, value in joints.items():
        if name not in known and name not in ("jaw",):
            raise InputError(
                f"joints: unknown joint {name!r}; expected one of: {', '.join(nearest_first(name, known))}"
            )
        if not np.isfinite(value):
            raise InputError(f"joints: {name}: expected a finite number, got {value}")
    values = np.array([joints.get(name, np.nan) for name in instrument.joint_names], dtype=np.float64)
    spread = np.deg2rad([config.readings.of(name) for name in instrument.joint_names])
    unused = [f"reading of {n}: not given" for n, v in zip(instrument.joint_names, values, strict=True) if np.isnan(v)]
    warnings = [
        _outside(name, value, low, high)
        for name, value, (low, high) in zip(instrument.joint_names, values, instrument.limits, strict=True)
        if value < low - 1e-6 or value > high + 1e-6
    ]
    turned = joints.get("roll")
    if turned is not None and instrument.roll_limits is not None:
        least, most = instrument.roll_limits
        if not least - 1e-6 <= turned <= most + 1e-6:
            warnings.append(_outside("roll", turned, least, most))
    low, high = instrument.limits.T.copy()
    if "jaw" in instrument.joint_names:
        # Jaws cannot pass through each other: a reading below zero presses them shut, and they look closed.
        low[instrument.joint_index("jaw")] = 0.0
    return Readings(values, spread, low, high), unused, warnings


def _outside(name: str, value: float, low: float, high: float) -> str:
    """Warn of a reading beyond limits, rad."""
    return (
        f"reading of {name}: {np.degrees(value):.1f} deg is outside its limits, "
        f"{np.degrees(low):.1f} to {np.degrees(high):.1f} deg"
    )


def reading_distance(readings: Readings, joints: Float64) -> float | None:
    """Root mean square distance of joints from those read, degrees."""
    known = ~np.isnan(readings.values)
    if not known.any():
        return None
    return float(np.degrees(np.sqrt(np.mean((joints - readings.values)[known] ** 2))))


def describe_limits(instrument: Instrument, arm: Arm) -> dict[str, Any]:
    """Say which limits and which kinematics of the arm a result is made with: rad, m."""
    return {
        "limits_from": instrument.limits_from,
        "limits": {name: pair.tolist() for name, pair in zip(instrument.joint_names, instrument.limits, strict=True)},
        "arm": arm,
        "roll_offset": instrument.roll_offset,
    }
