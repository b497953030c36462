"""Forward kinematics of the arm that holds the endoscope (ECM), from its base to the endoscope's tip.

The chain is that of a PSM up to roll: yaw and pitch about the remote centre of motion, insertion, and roll about the
endoscope's axis, which is the z axis of the tip's frame. Only the distance of the tip from the remote centre differs.
Constants are those of the dVRK's descriptions (``ECM.json`` and ``ECM_Si.json``, which differ in the limits only).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any, Final

import numpy as np

from dvrk_cmaes.geometry import Float64, transform
from dvrk_cmaes.instrument.arm import INSERTION_OFFSET, Arm, base_from_root_and_jacobian

TIP_OFFSET: Final = 0.3829 - 0.3822
"""Distance of the endoscope's tip from the remote centre of motion at an insertion of zero, m."""

ECM_LIMITS: Final[Mapping[Arm, tuple[tuple[float, float], ...]]] = {
    "classic": ((-1.5708, 1.5708), (-0.76794, 1.1344), (0.0, 0.255), (-1.552, 1.552)),
    "si": ((-2.964, 2.964), (-1.1, 1.04), (0.001, 0.259), (-1.54, 1.54)),
}
"""Lower and upper limits of the ECM's joints, rad and m, by arm."""

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
    offset = TIP_OFFSET - INSERTION_OFFSET["classic"]
    return base_from_root_and_jacobian(np.asarray(readings, np.float64), "classic", roll_offset=offset)


def joints_of_ecm_tip(ecm_from_tip: Any) -> Float64:
    """Return the joints (..., 4) at which the endoscope's tip has some poses (..., 4, 4) in the ECM's base, rad and m.

    Pitch is within a quarter turn; roll is within half a turn. A pose whose axis does not pass through the remote
    centre of motion has the joints of the nearest one whose axis does.
    """
    pose = np.asarray(ecm_from_tip, np.float64)
    place = pose[..., :3, 3]
    depth = np.linalg.norm(place, axis=-1)
    axis = np.where(depth[..., None] > 1e-9, place / np.maximum(depth, 1e-9)[..., None], pose[..., :3, 2])
    yaw = np.arctan2(axis[..., 0], -axis[..., 2])
    pitch = np.arctan2(-axis[..., 1], np.hypot(axis[..., 0], axis[..., 2]))
    zero = np.stack([yaw, pitch, depth - TIP_OFFSET, np.zeros_like(yaw)], axis=-1)
    unrolled = ecm_from_tip_and_jacobian(zero)[0][..., :3, :3]
    turn = np.swapaxes(unrolled, -1, -2) @ pose[..., :3, :3]
    zero[..., 3] = (np.arctan2(turn[..., 1, 0], turn[..., 0, 0]) + pi) % (2 * pi) - pi
    return zero
