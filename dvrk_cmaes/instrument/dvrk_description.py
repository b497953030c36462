"""The dVRK's own descriptions of tools and arms: JSON with comments, joints as modified Denavit-Hartenberg rows.

A tool's file has the joints ``roll``, ``wrist_pitch``, ``wrist_yaw`` and a ``jaw``; a kinematic file the arm's ``yaw``,
``pitch``, ``insertion``. Angles in rad, lengths in m; ``qmin`` and ``qmax`` are the limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET
from dvrk_cmaes.io.fields import Fields
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import listed

TOOL = "a dVRK tool description (JSON)"
KINEMATIC = "a dVRK kinematic description (JSON)"

_ARM_JOINTS = ("yaw", "pitch", "insertion")
_TOOL_JOINTS = ("roll", "wrist_pitch", "wrist_yaw")


@dataclass(frozen=True)
class DescribedJoint:
    """A row of the table; ``limits`` and ``offset`` in rad, or m where ``prismatic``."""

    name: str
    alpha: float
    a: float
    theta: float
    d: float
    offset: float
    prismatic: bool
    limits: tuple[float, float]


@dataclass(frozen=True)
class Tool:
    """A tool: where its wrist lies along the shaft, and how far its joints go.

    ``name`` is the file's. ``roll_offset`` is the D of its roll joint, m. ``limits`` are by joint, rad, of roll, the
    wrist and the jaw. ``wrist_length`` is the distance of its wrist axes, m.
    """

    name: str
    roll_offset: float
    limits: Mapping[str, tuple[float, float]]
    wrist_length: float


@dataclass(frozen=True)
class Kinematics:
    """An arm: the limits of its own joints, rad and m, and which arm of ours it is, None if it is neither."""

    name: str
    limits: Mapping[str, tuple[float, float]]
    insertion_offset: float
    arm: str | None


def is_description(document: Mapping[str, Any]) -> bool:
    """Whether a JSON document looks like a description of a tool or an arm."""
    return isinstance(document.get("DH"), dict)


def read_tool(path: str | Path) -> Tool:
    """Read a tool's description.

    Raises
    ------
    InputError
        Naming the file, the field and what was expected; also for a tool whose roll axis is not the shaft's.
    """
    fields = Fields.of(str(path), read_json_object(path, expected=TOOL, comments=True))
    joints = _joints(fields, _TOOL_JOINTS, TOOL)
    roll = joints["roll"]
    if any((roll.alpha, roll.a, roll.theta, roll.offset)) or roll.prismatic:
        raise InputError(f"{path}: DH.joints: roll: expected a revolute joint of alpha, A, theta and offset 0")
    limits = {name: joint.limits for name, joint in joints.items()}
    jaw = fields.inner("jaw")
    if jaw is not None:
        limits["jaw"] = _limits(jaw)
    return Tool(Path(path).name, roll.d, limits, joints["wrist_yaw"].a)


def read_kinematics(path: str | Path) -> Kinematics:
    """Read an arm's description; errors as for a tool's."""
    fields = Fields.of(str(path), read_json_object(path, expected=KINEMATIC, comments=True))
    joints = _joints(fields, _ARM_JOINTS, KINEMATIC)
    insertion = joints["insertion"]
    offset = insertion.offset + insertion.d
    known = [arm for arm, value in INSERTION_OFFSET.items() if isclose(value, offset, abs_tol=1e-4)]
    limits = {name: joint.limits for name, joint in joints.items()}
    return Kinematics(Path(path).name, limits, offset, known[0] if known else None)


def _joints(fields: Fields, names: tuple[str, ...], expected: str) -> dict[str, DescribedJoint]:
    """Rows of the table, which must have these joints."""
    table = fields.inner("DH", required=True)
    assert table is not None
    convention = table.text("convention")
    if convention != "modified":
        raise table.refuse("convention", "modified")
    joints = {joint.name: joint for joint in map(_joint, table.inners("joints"))}
    missing = [name for name in names if name not in joints]
    if missing:
        raise InputError(
            f"{fields.where}: DH.joints: expected {', '.join(names)} of {expected}, got {listed(joints) or 'none'}"
        )
    return joints


def _joint(row: Fields) -> DescribedJoint:
    kind = row.choice("type", ("revolute", "prismatic"))
    return DescribedJoint(
        name=row.text("name"),
        alpha=row.number("alpha"),
        a=row.number("A"),
        theta=row.number("theta"),
        d=row.number("D"),
        offset=row.number("offset", 0.0),
        prismatic=kind == "prismatic",
        limits=_limits(row),
    )


def _limits(row: Fields) -> tuple[float, float]:
    low, high = row.number("qmin"), row.number("qmax")
    if low > high:
        raise row.refuse("qmax", f"at least qmin, {low:g}")
    return low, high
