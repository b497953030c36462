"""Prior of the joint values in one frame: readings with their standard deviations, and joint limits.

A joint whose readings never move while the arm does was commanded, or not recorded, and not measured. Such a reading
has less information on its joint than a measured one: its standard deviation is larger.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.names import ECM_JOINTS, check_readings

if TYPE_CHECKING:
    from dvrk_cmaes.instrument import Instrument

LIMIT_SIGMA = float(np.deg2rad(3.0))
"""Standard deviation of the distance by which a joint may exceed its limits, rad."""


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings and limits of the instrument's joints, all in rad.

    ``values`` (J,) are the readings, NaN where unknown, with standard deviations ``sigma`` (J,). ``low`` and ``high``
    (J,) are the joint limits, used as soft bounds with standard deviation ``LIMIT_SIGMA``.
    """

    values: Float64
    sigma: Float64
    low: Float64
    high: Float64

    @staticmethod
    def none(instrument: Instrument) -> Readings:
        """Return no readings, only the limits of an instrument's joints."""
        count = len(instrument.joint_names)
        low, high = instrument.limits.T.copy()
        if "jaw" in instrument.joint_names:
            # Jaws cannot pass through each other: a reading below zero presses them together, and they look closed.
            low[instrument.joint_names.index("jaw")] = 0.0
        return Readings(np.full(count, np.nan), np.full(count, np.inf), low, high)

    def cost(self, joints: Float64) -> Float64:
        """Sum the squared deviations of joints (..., J) from readings and limits, in standard deviations, (...)."""
        beyond = np.maximum(self.low - joints, 0) + np.maximum(joints - self.high, 0)
        weight, centre = self.weight_and_centre
        return np.asarray((weight * (joints - centre) ** 2 + (beyond / LIMIT_SIGMA) ** 2).sum(axis=-1))

    @cached_property
    def weight_and_centre(self) -> tuple[Float64, Float64]:
        """The inverse variances (J,) of the readings and their values (J,), zero where there is none."""
        known = ~np.isnan(self.values)
        return np.where(known, 1 / self.sigma**2, 0.0), np.where(known, self.values, 0.0)


def split_readings(
    instrument: Instrument, joints: Mapping[str, float], config: EstimateConfig
) -> tuple[Readings, list[str], list[str]]:
    """Select the readings of the instrument's joints from all readings of a frame.

    Returns the readings, descriptions of those that are missing, and warnings about values outside the joint limits.
    Raises `InputError` for an unknown joint name, or a value that is not finite or in another unit.
    """
    known = (*instrument.joint_names, *OUTER_JOINTS, *ECM_JOINTS)
    check_readings("joints", joints, known)
    values = np.array([joints.get(name, np.nan) for name in instrument.joint_names], dtype=np.float64)
    sigma = np.deg2rad([config.readings.of(name) for name in instrument.joint_names])
    unused = [
        f"reading of {n}: not given, or NaN" for n, v in zip(instrument.joint_names, values, strict=True) if np.isnan(v)
    ]
    warnings = [
        _outside(name, value, low, high)
        for name, value, (low, high) in zip(instrument.joint_names, values, instrument.limits, strict=True)
        if value < low - 1e-6 or value > high + 1e-6
    ]
    roll = joints.get("roll")
    if roll is not None and instrument.roll_limits is not None:
        least, most = instrument.roll_limits
        if not least - 1e-6 <= roll <= most + 1e-6:
            warnings.append(_outside("roll", roll, least, most))
    return replace(Readings.none(instrument), values=values, sigma=sigma), unused, warnings


def _outside(name: str, value: float, low: float, high: float) -> str:
    """Return the warning about a reading outside its limits, rad."""
    return (
        f"reading of {name}: {np.degrees(value):.1f} deg is outside its limits, "
        f"{np.degrees(low):.1f} to {np.degrees(high):.1f} deg{': rad is expected' if abs(value) > np.pi else ''}"
    )


def reading_distance(readings: Readings, joints: Float64) -> float | None:
    """Compute the root mean square deviation of joints (J,) from the known readings, degrees; None without any."""
    known = ~np.isnan(readings.values)
    if not known.any():
        return None
    return float(np.degrees(np.sqrt(np.mean((joints - readings.values)[known] ** 2))))


_LEAST_FRAMES: Final = 5  # in which a joint has the same reading
_SAME: Final = 1e-9  # rad
_MOVES: Final = 0.01  # rad or m, by which an outer joint moves at least
_WIDER: Final = 2.0
"""Factor on the standard deviations of commanded joints, that of their readings and that from frame to frame."""


def commanded_in(readings: Sequence[Mapping[str, float]], names: Sequence[str]) -> list[str]:
    """Return the joints among some whose readings never change in frames while those of the outer joints do.

    ``readings`` are those of the frames, by joint.
    """
    rows = [[own.get(name, np.nan) for name in OUTER_JOINTS] for own in readings]
    outer = np.array([row for row in rows if not np.isnan(row).any()])
    if not len(outer) or np.ptp(outer, axis=0).max() <= _MOVES:
        return []
    found = {name: [value for own in readings if (value := own.get(name, np.nan)) == value] for name in names}
    return [name for name, read in found.items() if len(read) >= _LEAST_FRAMES and np.ptp(read) < _SAME]


def describe_commanded(commanded: Sequence[str]) -> str:
    """Return the warning that the readings of some joints, at least one, never move."""
    part = "jaw" if list(commanded) == ["jaw"] else "wrist"
    joints = " and ".join(filter(None, [", ".join(commanded[:-1]), commanded[-1]]))
    return (
        f"{part} readings never move: {joints} constant while the arm moves; taken for commanded values, with "
        f"{_WIDER:g} times the usual standard deviation"
    )


def with_commanded(config: EstimateConfig, commanded: Collection[str], names: Sequence[str]) -> EstimateConfig:
    """Return settings for a session in which some of an instrument's joints ``names`` are commanded.

    Standard deviations that are not the default ones are kept. The wrist's joints share one from frame to frame, which
    is wider where all of them are commanded.
    """
    wrist = [name for name in names if name != "jaw"]
    own = {field.name for field in fields(config.readings)}
    readings = [f"{name}_deg" if f"{name}_deg" in own else "other_deg" for name in commanded]
    session = ["jaw_deg"] if "jaw" in commanded else []
    session += ["wrist_deg"] if wrist and set(wrist) <= set(commanded) else []
    return replace(config, readings=_widened(config.readings, readings), session=_widened(config.session, session))


def _widened(settings: Any, names: Collection[str]) -> Any:
    """Return a table of settings with some standard deviations widened, where they are the default ones."""
    usual = vars(type(settings)())
    wide = {name: _WIDER * usual[name] for name in names if getattr(settings, name) == usual[name]}
    return replace(settings, **wide)
