"""Readers of the dVRK's description files of tools and arms: JSON with comments, modified DH parameters.

A tool file has the joints ``roll``, ``wrist_pitch`` and ``wrist_yaw`` and an object ``jaw``; a kinematic file has the
arm joints ``yaw``, ``pitch`` and ``insertion``. Angles are in rad, lengths in m; ``qmin`` and ``qmax`` are the limits.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct, field

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.arm import ROLL_OFFSET, TOOLTIP_OFFSET, WRIST_LENGTH
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.io.typed_document import Number, Transform, convert_document, refused

TOOL = "a dVRK tool description (JSON)"

_TOOL_JOINTS = ("roll", "wrist_pitch", "wrist_yaw")


class _Limits(Struct):
    qmin: Number
    qmax: Number


class JointDescription(_Limits):
    """One row of the DH table; limits and ``offset`` in rad, in m for a prismatic joint."""

    type: Literal["revolute", "prismatic"]
    alpha: Number
    a: Number = field(name="A")
    theta: Number
    d: Number = field(name="D")
    offset: Number = 0.0
    name: str = ""


class _Table(Struct):
    convention: Annotated[Literal["modified"], Meta(description="modified")]
    joints: tuple[JointDescription, ...] = ()


class _Description(Struct, rename={"dh": "DH"}):
    dh: _Table
    jaw: _Limits | None = None
    tooltip_offset: Transform | None = None


@dataclass(frozen=True, eq=False)
class Tool:
    """Kinematic parameters of a tool, by default those of the Large Needle Driver 400006, without limits.

    Parameters
    ----------
    name
        Name of the description file.
    roll_offset
        DH parameter d of the roll joint, m: the position of the wrist along the shaft.
    limits
        Lower and upper limits of roll, the wrist joints and, if described, the jaw, rad, by joint name.
    wrist_length
        Distance between the two wrist axes, m.
    tooltip_offset : (4, 4)
        Pose of the tool tip frame in the wrist yaw frame, m.
    """

    name: str = "400006"
    roll_offset: float = ROLL_OFFSET
    limits: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    wrist_length: float = WRIST_LENGTH
    tooltip_offset: Float64 = dataclasses.field(default_factory=TOOLTIP_OFFSET.copy)


def read_tool(path: str | Path) -> Tool:
    """Read a tool's description.

    Raises
    ------
    InputError
        A field is missing or wrong, or the roll axis is not the shaft's axis; the message names the file and field.
    """
    description = _read(path)
    joints = {joint.name: joint for joint in description.dh.joints}
    roll = joints["roll"]
    if any((roll.alpha, roll.a, roll.theta, roll.offset)) or roll.type == "prismatic":
        raise InputError(f"{path}: DH.joints: roll: expected a revolute joint of alpha, A, theta and offset 0")
    limits = {name: (joint.qmin, joint.qmax) for name, joint in joints.items()}
    if description.jaw is not None:
        limits["jaw"] = description.jaw.qmin, description.jaw.qmax
    offset = np.eye(4) if description.tooltip_offset is None else description.tooltip_offset
    return Tool(Path(path).name, roll.d, limits, joints["wrist_yaw"].a, offset)


def _read(path: str | Path) -> _Description:
    """Read a description whose DH table has the joints of a tool."""
    where = str(path)
    description = convert_document(where, read_json_object(path, expected=TOOL, comments=True), _Description)
    rows: dict[str, _Limits] = {f"DH.joints[{k}]": row for k, row in enumerate(description.dh.joints)}
    if description.jaw is not None:
        rows["jaw"] = description.jaw
    for name, row in rows.items():
        if row.qmin > row.qmax:
            raise refused(where, f"{name}.qmax", f"at least qmin, {row.qmin:g}", row.qmax)
    joints = [joint.name for joint in description.dh.joints]
    if not set(_TOOL_JOINTS) <= set(joints):
        names_read = listed(joints) or "none"
        raise InputError(f"{where}: DH.joints: expected {', '.join(_TOOL_JOINTS)} of {TOOL}, got {names_read}")
    return description
