"""Inverse kinematics of the patient-side manipulator (PSM): its six joints from the pose of the tool's tip.

The shaft passes through the RCM, the origin of the base. The wrist's pitch axis meets the shaft at a right angle, and
the wrist yaw axis is parallel to it at the wrist's length. So the pitch axis is perpendicular to the line from the RCM
to the yaw axis' origin, which gives wrist yaw in closed form; the other joints follow one by one.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Final, NamedTuple

import numpy as np

from dvrk_cmaes.geometry import Float64, inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm, base_from_root, outer_joints_at
from dvrk_cmaes.instrument.dvrk_description import Tool

POSED_JOINTS: Final = (*OUTER_JOINTS, "wrist_pitch", "wrist_yaw")
"""Joints found from the pose of the tip, in the order of the chain and of the dVRK's ``measured_js``; m and rad."""

_SINGULAR: Final = 1e-9  # m; distance of the RCM from the wrist yaw axis below which wrist yaw is not determined


class JointSolution(NamedTuple):
    """Joints of poses, in the order of ``POSED_JOINTS``.

    Parameters
    ----------
    joints : (N, 6)
        Yaw, pitch (rad), insertion (m), roll, wrist pitch, wrist yaw (rad); NaN for poses that are not reached.
    reasons : (N,)
        Why a pose is not reached; empty for the others.
    """

    joints: Float64
    reasons: tuple[str, ...]


def find_joints(base_from_tip: Float64, arm: Arm = "classic", tool: Tool | None = None) -> JointSolution:
    """Find the joints at which ``base_from_root @ root_from_tip`` is each of the poses (N, 4, 4) of the tip, m.

    Of the two solutions, that with wrist yaw within a quarter turn is taken. Roll is within half a turn of zero for the
    first pose, and continued over its wrap from each pose to the next, in the order of the rows. Poses beyond the
    limits of the ``tool`` are not reached. Poses with the RCM on the wrist yaw axis have no wrist yaw and are not
    reached either.
    """
    tool = tool or Tool()
    joints = np.full((len(base_from_tip), len(POSED_JOINTS)), np.nan)
    base_from_yaw = base_from_tip @ inverse(tool.tooltip_offset)
    x, y, origin = (base_from_yaw[:, :3, k] for k in (0, 1, 3))
    along_x, along_y = (origin * x).sum(axis=1), (origin * y).sum(axis=1)
    known = np.hypot(along_x, along_y) > _SINGULAR
    theta = np.arctan2(-along_y, along_x)  # of the DH row of wrist yaw; theta + pi is the other solution
    yaw = np.remainder(theta + pi / 2 + pi / 2, pi) - pi / 2
    cosine, sine = np.sin(yaw)[:, None], -np.cos(yaw)[:, None]  # of yaw - pi / 2
    forward = cosine * x - sine * y  # from the wrist pitch axis to the wrist yaw axis
    pitch_axis = -(sine * x + cosine * y)
    root_origin = origin - tool.wrist_length * forward
    depth = np.linalg.norm(root_origin, axis=1)
    known &= depth > _SINGULAR
    shaft = root_origin / np.where(known, depth, 1.0)[:, None]
    side = np.cross(pitch_axis, shaft)  # the root's x axis; its y axis is the pitch axis
    joints[:, :3] = outer_joints_at(root_origin, arm, roll_offset=tool.roll_offset)
    unrolled = base_from_root(np.concatenate([joints[:, :3], np.zeros((len(joints), 1))], axis=1), arm)
    joints[:, 3] = np.arctan2((unrolled[:, :3, 1] * side).sum(axis=1), (unrolled[:, :3, 0] * side).sum(axis=1))
    joints[:, 4] = np.arctan2((forward * side).sum(axis=1), (forward * shaft).sum(axis=1))
    joints[:, 5] = yaw
    joints[~known] = np.nan
    joints[known, 3] = np.unwrap(joints[known, 3])
    reasons = tuple(_reason(row, bool(one), tool.limits) for row, one in zip(joints, known, strict=True))
    joints[[bool(reason) for reason in reasons]] = np.nan
    return JointSolution(joints, reasons)


def _reason(joints: Float64, known: bool, limits: Mapping[str, tuple[float, float]]) -> str:
    """Return why joints (6,) are not reached; empty if they are."""
    if not known:
        return "the remote centre of motion is on the wrist yaw axis: wrist yaw is not determined"
    for name, value in zip(POSED_JOINTS, joints, strict=True):
        low, high = limits.get(name, (-np.inf, np.inf))
        if not low <= value <= high:
            factor, unit = (1e3, "mm") if name == "insertion" else (180 / pi, "deg")
            return f"{name} {factor * value:.1f} {unit} is outside {factor * low:.1f} to {factor * high:.1f} {unit}"
    return ""
