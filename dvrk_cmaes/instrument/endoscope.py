"""Forward kinematics of the arm that holds the endoscope (ECM), from its base to the endoscope's tip.

The chain is that of a PSM up to roll: yaw and pitch about the remote centre of motion, insertion, and roll about the
endoscope's axis, which is the z axis of the tip's frame. Only the distance of the tip from the remote centre differs.
Constants are those of the dVRK's descriptions (``ECM.json`` and ``ECM_Si.json``, which differ in the limits only).
"""

from __future__ import annotations

from math import pi
from typing import Any, Final

import numpy as np

from dvrk_cmaes.geometry import Float64, transform
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET, base_from_root_and_jacobian, outer_joints_at

TIP_OFFSET: Final = 0.3829 - 0.3822
"""Distance of the endoscope's tip from the remote centre of motion at an insertion of zero, m."""

_ROLL_OFFSET: Final = TIP_OFFSET - INSERTION_OFFSET["classic"]  # as if the tip were the root of an instrument
_LEAST_DEPTH: Final = 1e-9  # m

STRAIGHT: Final = transform(np.diag([-1.0, -1.0, 1.0]), [0.0, 0.0, 0.0])
"""Pose (4, 4) of the camera of a straight endoscope in the tip's frame, without turn about the axis."""


def ecm_from_tip_and_jacobian(readings: Float64) -> tuple[Float64, Float64]:
    """Compute the pose (..., 4, 4) of the endoscope's tip in the ECM's base, and its Jacobian (..., 6, 4).

    The Jacobian is of small changes in the tip's own axes, m and rad.

    Parameters
    ----------
    readings : (..., 4)
        Yaw, pitch (rad), insertion (m) and roll (rad) of the ECM.
    """
    return base_from_root_and_jacobian(np.asarray(readings, np.float64), "classic", roll_offset=_ROLL_OFFSET)


def joints_of_ecm_tip(ecm_from_tip: Any) -> Float64:
    """Return the joints (..., 4) at which the endoscope's tip has some poses (..., 4, 4) in the ECM's base, rad and m.

    Pitch is within a quarter turn; roll is within half a turn. A pose whose axis does not pass through the remote
    centre of motion has the joints of the nearest one whose axis does.
    """
    pose = np.asarray(ecm_from_tip, np.float64)
    depth = np.linalg.norm(pose[..., :3, 3], axis=-1, keepdims=True)
    place = np.where(depth > _LEAST_DEPTH, pose[..., :3, 3], _LEAST_DEPTH * pose[..., :3, 2])
    aimed = outer_joints_at(place, roll_offset=_ROLL_OFFSET)
    zero = np.concatenate([aimed, np.zeros_like(depth)], axis=-1)
    unrolled = ecm_from_tip_and_jacobian(zero)[0][..., :3, :3]
    turn = np.swapaxes(unrolled, -1, -2) @ pose[..., :3, :3]
    zero[..., 3] = (np.arctan2(turn[..., 1, 0], turn[..., 0, 0]) + pi) % (2 * pi) - pi
    return zero
