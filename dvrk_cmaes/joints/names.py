"""Names and units of joint readings, and the checks that every file of readings goes through.

Revolute joints are in rad, ``insertion`` in m. What can only be another unit is refused: no joint of a dVRK turns
by more than a full turn, or is inserted by more than a metre.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.short_text import shown

OUTER_JOINTS = ("yaw", "pitch", "insertion", "roll")
"""Joints of the arm that carries the instrument, from the base outwards."""

WRIST_JOINTS = ("wrist_pitch", "wrist_yaw", "jaw")
"""Joints of the instrument that the camera sees."""

ARM_ORDER = (*OUTER_JOINTS, "wrist_pitch", "wrist_yaw")
"""Order of the six values that the dVRK publishes as ``measured_js``; the jaw has a topic of its own."""

_PREFIX = re.compile(r"(PSM\d*_)?(outer_)?", re.IGNORECASE)


def all_names(known: Iterable[str] = ()) -> tuple[str, ...]:
    """All joints that a reading may be of, each once: the dVRK's and an instrument's own."""
    return tuple(dict.fromkeys((*WRIST_JOINTS, *OUTER_JOINTS, *known)))


def check_joint(where: str, name: str, names: Sequence[str]) -> None:
    """Refuse a joint that is not known, with the known ones, the likeliest first."""
    if name not in names:
        near = ", ".join(nearest_first(name[:60], names))
        raise InputError(f"{where}: unknown joint {shown(name)}; expected one of {near}")


def plain_joint(name: str, names: Sequence[str]) -> str:
    """Name of a joint without what ROS puts before it: an arm's name, or ``outer_`` in older dVRK versions."""
    return name if name in names else _PREFIX.sub("", name, count=1)


def ordered_joints(where: str, count: int) -> tuple[str, ...]:
    """Joints that values without names are of, by their number: six of the arm, the jaw alone, or all seven."""
    orders = {len(ARM_ORDER): ARM_ORDER, 1: ("jaw",), len(ARM_ORDER) + 1: (*ARM_ORDER, "jaw")}
    if count not in orders:
        raise InputError(f"{where}: expected 6 values ({', '.join(ARM_ORDER)}), 1 (jaw) or all 7, got {count}")
    return orders[count]


def joint_reading(where: str, name: str, cell: object) -> float:
    """Value of a number or of its text; refuses what can only be another unit."""
    unit = "m" if name == "insertion" else "rad"
    try:
        value = float(cell) if isinstance(cell, str | int | float) and not isinstance(cell, bool) else math.nan
    except (ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {name}: expected a finite number in {unit}, got {shown(cell)}")
    if unit == "m" and abs(value) > 1:
        raise InputError(f"{where}: {name}: expected metres, got {value:g}: this looks like millimetres")
    if unit == "rad" and abs(value) > 2 * math.pi:
        raise InputError(f"{where}: {name}: expected radians (at most 2 pi), got {value:g}: this looks like degrees")
    return value
