"""Joints of an arm's Cartesian poses, by inverse kinematics: those of a table given with a recording, or of its own.

A table of the arm's measured Cartesian poses is CSV: ``time`` (s), the position ``x``, ``y``, ``z`` (m), the unit
quaternion ``qx``, ``qy``, ``qz``, ``qw``, and, if known, ``jaw`` (rad). Which frames the poses relate is not in such
tables; it is an argument of `read_pose_table`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, inverse, transform
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.instrument.dvrk_description import Tool
from dvrk_cmaes.instrument.inverse_kinematics import POSED_JOINTS, find_joints
from dvrk_cmaes.io.csv_file import number_in, read_csv_rows
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.joints.times import parse_time

PosePoint = Literal["tip", "wrist-yaw"]

POSE = {"x": "m", "y": "m", "z": "m", "qx": "", "qy": "", "qz": "", "qw": ""}
_EXPECTED = "a table of poses (CSV with time, x, y, z, qx, qy, qz, qw)"
_UNIT = 1e-3  # tolerance of a quaternion's length


def read_pose_table(
    path: Path, point: PosePoint, reference_from_base: Float64, arm: Arm = "classic", tool: Tool | None = None
) -> tuple[TimedReadings, ...]:
    """Read a table of poses and find the joints, NaN for poses that are not reached.

    Parameters
    ----------
    path
        The CSV file.
    point
        Origin of the posed frame: dVRK's tip, or the wrist yaw axis. Its axes are the tip frame's in both cases.
    reference_from_base : (4, 4)
        Pose of the arm's base in the frame that the poses are given in, m; the identity for ``local/measured_cp``.
    arm
        The arm's kinematics.
    tool
        The tool's description; None for the Large Needle Driver 400006.

    Raises
    ------
    InputError
        The table is not valid, or no pose is reached; the message names the file and the line or the reason.
    """
    header, rows = read_csv_rows(path, expected=_EXPECTED)
    missing = [name for name in ("time", *POSE) if name not in header]
    if missing or not rows:
        got = f"no {', '.join(missing)} in {listed(header)}" if missing else "a header only"
        raise InputError(f"{path}: header: expected {_EXPECTED}, got {got}")
    rows = sorted(rows, key=lambda row: parse_time(row[0], row[1]["time"]))  # in which roll is continued
    times = [parse_time(where, cells["time"]) for where, cells in rows]
    values = [[number_in(where, name, cells, unit) for name, unit in POSE.items()] for where, cells in rows]
    poses = poses_of([where for where, _ in rows], np.array(values))
    found, said = joints_of_poses(path, inverse(reference_from_base) @ poses, point, arm, tool)
    series = [TimedReadings.of(f"{path} ({said})", POSED_JOINTS, times, found.tolist())]
    if "jaw" in header:
        jaw = [[number_in(where, "jaw", cells, "rad") if cells["jaw"] else np.nan] for where, cells in rows]
        series.append(TimedReadings.of(str(path), ("jaw",), times, jaw))
    return tuple(series)


def joints_of_poses(path: Path, poses: Float64, point: PosePoint, arm: Arm, tool: Tool | None) -> tuple[Float64, str]:
    """Find the joints (N, 6) of poses (N, 4, 4) in the arm's base, and say how; arguments as of `read_pose_table`."""
    tool = tool or Tool()
    if point == "wrist-yaw":
        tool = replace(tool, tooltip_offset=transform(tool.tooltip_offset[:3, :3], np.zeros(3)))
    found = find_joints(poses, arm, tool)
    if all(found.reasons):
        raise InputError(f"{path}: expected poses that a {arm} arm reaches, got none, e.g. {found.reasons[0]}")
    said = f"inverse kinematics of poses of the {point}, {arm} arm"
    beyond = [reason for reason in found.reasons if reason]
    if beyond:
        said += f"; {len(beyond)} of {len(poses)} poses are not reached, e.g. {beyond[0]}"
    return found.joints, said


def poses_of(wheres: Sequence[str], values: Float64) -> Float64:
    """Convert positions, m, and quaternions xyzw (N, 7) to poses (N, 4, 4); InputError for those that are not unit."""
    from scipy.spatial.transform import Rotation  # imported late: most imports do without

    lengths = np.linalg.norm(values[:, 3:], axis=1)
    for where, row, length in zip(wheres, values, lengths, strict=True):
        if not abs(length - 1) <= _UNIT:
            raise InputError(f"{where}: qx: expected a unit quaternion qx, qy, qz, qw, got {shown(row[3:].tolist())}")
    return transform(Rotation.from_quat(values[:, 3:]).as_matrix(), values[:, :3])
