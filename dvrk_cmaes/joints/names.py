"""Names and units of joint readings, and checks common to all file formats.

Revolute joints are in rad, ``insertion`` in m. Values of more than a full turn or more than a metre are beyond the
range of every dVRK joint and are refused as values in another unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.instrument.inverse_kinematics import POSED_JOINTS
from dvrk_cmaes.io.arguments import check_type, checked_number
from dvrk_cmaes.io.short_text import listed, shown

WRIST_JOINTS = ("wrist_pitch", "wrist_yaw", "jaw")
"""Joints of the instrument's wrist and jaws, which the camera sees."""

ECM_JOINTS = ("ecm_yaw", "ecm_pitch", "ecm_insertion", "ecm_roll")
"""Joints of the arm that holds the endoscope (ECM), from its base to the tip; insertion in m, the others in rad."""

READINGS = "a mapping of joint names to readings, e.g. {'jaw': 0.5}"
"""What is expected of the readings of one time."""

_PREFIX = re.compile(r"(?:(PSM\d*|ECM\d*|MTM[LR]?|SUJ)(?:_|/|::?))?(?:outer_)?", re.IGNORECASE)


def notes_on_messages(*, unnamed: bool, skipped: int) -> tuple[str, ...]:
    """Return notes on messages whose joints are not named, and on those that have no joints, as before an arm is up."""
    notes = ["joints are not named: taken in the dVRK's order, by their number"] if unnamed else []
    return (*notes, *([f"{skipped} message{'' if skipped == 1 else 's'} without positions skipped"] if skipped else []))


def accepted_names(known: Iterable[str] = ()) -> tuple[str, ...]:
    """Return all accepted joint names, each once: those of the dVRK and ``known`` ones of an instrument."""
    return tuple(dict.fromkeys((*WRIST_JOINTS, *OUTER_JOINTS, *known, *ECM_JOINTS)))


def check_joint(where: str, name: str, names: Sequence[str]) -> None:
    """Raise InputError for an unknown joint; the message lists the known ones, most similar first.

    Those of the endoscope's arm are listed for a name that begins like them.
    """
    if name not in names:
        like = [one for one in names if one not in ECM_JOINTS or name.lower().startswith("ecm")]
        near = ", ".join(nearest_first(name[:60], dict.fromkeys(like)))
        hint = " (--columns names columns, - one that is not read)" if where.endswith("header") else ""
        raise InputError(f"{where}: unknown joint {shown(name)}; expected one of {near}{hint}")


def joints_of_arm(where: str, stated: Sequence[str], names: Sequence[str], arm: str | None = None) -> dict[str, int]:
    """Return the places of one arm's joints among stated names, which may have ROS prefixes.

    A name may begin with an arm's, such as ``PSM1_``, and with ``outer_`` of older dVRK versions, and end in
    ``_joint``. The joints of other arms are left out. Names without an arm belong to every arm.

    Parameters
    ----------
    where
        Prefix of error messages.
    stated
        The names as they are written.
    names
        Names of the joints that are accepted.
    arm
        The arm that is asked for; None for the only one.

    Returns
    -------
    dict
        Index into ``stated`` by joint.

    Raises
    ------
    InputError
        There are joints of several instrument arms and none is asked for, or not of the one that is; a joint is unknown
        or there twice.
    """
    split = [_split(name, names) for name in stated]
    arms = list(dict.fromkeys(own for own, _ in split if own))
    tools = [own for own in arms if own.startswith("PSM")] or arms
    chosen = arm.upper() if arm is not None and arm.upper().startswith("PSM") else None
    if chosen is None and len(tools) > 1:
        raise InputError(
            f"{where}: expected the joints of one arm, got those of {listed(tools)}: say which one (--only {tools[0]} "
            f'of estimate, --arm {tools[0]} of import, or arm = "{tools[0]}" in session.toml)'
        )
    if chosen is not None and tools and chosen not in tools:
        raise InputError(f"{where}: expected the joints of {chosen}, got those of {listed(tools)}")
    found: dict[str, int] = {}
    for place, (own, joint) in enumerate(split):
        if own not in ("", chosen or (tools or [""])[0]):
            continue
        check_joint(where, joint, names)
        if joint in found:
            raise InputError(
                f"{where}: {joint}: expected each joint once, got {listed([stated[found[joint]]])} and "
                f"{listed([stated[place]])}"
            )
        found[joint] = place
    return found


def _split(name: str, names: Sequence[str]) -> tuple[str, str]:
    """Split a ROS name into that of the arm, in capitals and empty if there is none, and that of the joint."""
    match = None if name in names else _PREFIX.match(name)
    return ("", name) if match is None else ((match[1] or "").upper(), name[match.end() :].removesuffix("_joint"))


def joints_by_count(where: str, count: int) -> tuple[str, ...]:
    """Return the joints of unnamed values by their number: six of the arm, the jaw alone, or all seven."""
    orders = {len(POSED_JOINTS): POSED_JOINTS, 1: ("jaw",), len(POSED_JOINTS) + 1: (*POSED_JOINTS, "jaw")}
    if count not in orders:
        raise InputError(f"{where}: expected 6 values ({', '.join(POSED_JOINTS)}), 1 (jaw) or all 7, got {count}")
    return orders[count]


def check_readings(where: str, joints: object, known: Sequence[str]) -> None:
    """Raise an InputError for readings that are no mapping of known joints to finite numbers in rad (insertion: m)."""
    check_type(where, joints, Mapping, READINGS)
    assert isinstance(joints, Mapping)
    for name, value in joints.items():
        check_joint(where, str(name), [*known, "jaw"])
        joint_reading(where, name, checked_number(f"{where}: {name}", value, f"a finite number in {unit_of(name)}"))


def unit_of(name: str) -> str:
    """Return the unit of a joint's readings, or of a coordinate."""
    return "m" if name in ("insertion", "ecm_insertion", "x", "y", "z") else "rad"


def shown_unit(joint: str) -> tuple[float, str]:
    """Return the factor from m or rad to the unit in which a joint is shown, and that unit, mm or deg."""
    return (1e3, "mm") if joint.endswith("insertion") else (math.degrees(1), "deg")


def joint_reading(where: str, name: str, cell: object) -> float:
    """Convert a number or its text to a reading; InputError if it is not finite or must be in another unit."""
    unit = unit_of(name)
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
