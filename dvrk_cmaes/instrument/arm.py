"""Forward kinematics of the patient-side manipulator (PSM), from its base to the instrument's root link.

The base frame's origin is the remote centre of motion (RCM), through which the shaft passes in every configuration.
Yaw, pitch and insertion are joints of the arm; roll is a joint of the tool, and its frame is the root link (DH
frame 4). With the pose of the root link in the camera,
``camera_from_base = camera_from_root @ inverse(base_from_root)``.

The constants are those of the dVRK's kinematic descriptions (``PSM.json`` for the Classic, ``PSM_Si.json`` and the
tools' files). Right angles are exact here; the files round them to 1.5708.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import pi
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float64, inverse, skew
from dvrk_cmaes.io.arguments import described

Arm = Literal["classic", "si"]

OUTER_JOINTS: Final = ("yaw", "pitch", "insertion", "roll")
"""Joints from the base to the root link, in the order of the chain; insertion in m, the others in rad."""

ROLL_OFFSET: Final = 0.4162
"""DH parameter d of the roll joint of tools 400xxx, m: distance from the insertion frame to the wrist pitch axis."""

ROLL_OFFSET_LONG: Final = 0.467
"""DH parameter d of the roll joint of tools 420xxx, which have longer shafts, m."""

INSERTION_OFFSET: Final[Mapping[str, float]] = {"classic": -0.4318, "si": -0.4826}
"""Constant added to the insertion reading to give d of the insertion joint, m, by arm."""

WRIST_LENGTH: Final = 0.0091
"""DH parameter a of the wrist yaw joint of the Large Needle Driver 400006, m: distance between the wrist axes."""

TOOLTIP_OFFSET: Final = np.array([[0.0, -1, 0, 0], [0, 0, 1, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
"""Pose of the dVRK's tool tip frame in the wrist yaw frame (DH frame 6), of the Large Needle Driver 400006."""

_LEAST_DEPTH: Final = 1e-12  # m, of a place whose direction from the remote centre of motion is known


class DHJoint(NamedTuple):
    """One row of a table of modified Denavit-Hartenberg parameters: Rx(alpha) Tx(a) Rz(theta) Tz(d)."""

    alpha: float
    a: float
    theta: float
    d: float
    prismatic: bool = False


def check_arm(arm: object) -> None:
    """Raise an InputError for something else than the name of an arm whose kinematics are known."""
    if not isinstance(arm, str) or arm not in INSERTION_OFFSET:
        near = " or ".join(nearest_first(str(arm), INSERTION_OFFSET))
        raise InputError(f"arm: expected {near}, got {described(arm)}")


def dh_table(arm: Arm = "classic", *, roll_offset: float = ROLL_OFFSET) -> tuple[DHJoint, ...]:
    """Return the DH rows of yaw, pitch, insertion and roll.

    The value of a revolute joint is added to theta, the value of the prismatic joint to d.

    Raises
    ------
    InputError
        The arm is not one of ``INSERTION_OFFSET``.
    """
    check_arm(arm)
    return (
        DHJoint(alpha=pi / 2, a=0.0, theta=pi / 2, d=0.0),
        DHJoint(alpha=-pi / 2, a=0.0, theta=-pi / 2, d=0.0),
        DHJoint(alpha=pi / 2, a=0.0, theta=0.0, d=INSERTION_OFFSET[arm], prismatic=True),
        DHJoint(alpha=0.0, a=0.0, theta=0.0, d=roll_offset),
    )


def base_from_root(
    outer: Mapping[str, ArrayLike] | ArrayLike, arm: Arm = "classic", *, roll_offset: float = ROLL_OFFSET
) -> Float64:
    """Compute the forward kinematics of the arm: the pose of the instrument's root link in the PSM base frame.

    Parameters
    ----------
    outer : (..., 4), or a mapping of the names in ``OUTER_JOINTS`` to arrays (...)
        Yaw, pitch (rad), insertion (m), roll (rad); other joints in a mapping are ignored.
    arm
        ``classic`` or ``si``.
    roll_offset
        DH parameter d of the tool's roll joint, m.

    Returns
    -------
    (..., 4, 4)
        ``base_from_root``. The distance of the root's origin from the RCM is insertion + insertion offset of the
        arm + ``roll_offset``.

    Raises
    ------
    InputError
        The arm is unknown, a joint is missing from the mapping, or the number of values is not four.
    """
    values = _values(outer)
    pose = np.broadcast_to(np.eye(4), (*values.shape[:-1], 4, 4))
    for step in _row_transforms(dh_table(arm, roll_offset=roll_offset), values):
        pose = pose @ step
    return pose


def base_from_root_and_jacobian(
    outer: Float64, arm: Arm = "classic", *, roll_offset: float = ROLL_OFFSET
) -> tuple[Float64, Float64]:
    """Compute the pose of `base_from_root` and its Jacobian (..., 6, 4) by the outer joints (..., 4), rad and m.

    The Jacobian is of small changes in the root's own axes, m and rad: each joint turns about or moves along the z axis
    of its own frame. Errors as `base_from_root`.
    """
    rows = dh_table(arm, roll_offset=roll_offset)
    steps = _row_transforms(rows, outer)
    jacobian = np.zeros((*outer.shape[:-1], 6, len(rows)))
    link_from_root = np.broadcast_to(np.eye(4), (*outer.shape[:-1], 4, 4))
    for k in reversed(range(len(rows))):
        axis = link_from_root[..., 2, :3]  # of the joint, in the root's axes
        if rows[k].prismatic:
            jacobian[..., :3, k] = axis
        else:
            from_joint = np.swapaxes(link_from_root[..., :3, :3], -1, -2) @ link_from_root[..., :3, 3:]
            jacobian[..., :3, k] = (skew(axis) @ from_joint)[..., 0]
            jacobian[..., 3:, k] = axis
        link_from_root = steps[k] @ link_from_root
    return np.asarray(link_from_root), jacobian


def outer_joints_at(places: Float64, arm: Arm = "classic", *, roll_offset: float = ROLL_OFFSET) -> Float64:
    """Return yaw, pitch, insertion (..., 3), rad and m, with the origin of the root at places (..., 3) in the base, m.

    Pitch is within a quarter turn. Other arguments are as of `base_from_root`.
    """
    depth = np.linalg.norm(places, axis=-1)
    x, y, z = np.moveaxis(places / np.maximum(depth, _LEAST_DEPTH)[..., None], -1, 0)
    insertion = depth - INSERTION_OFFSET[arm] - roll_offset
    return np.stack([np.arctan2(x, -z), np.arctan2(-y, np.hypot(x, z)), insertion], axis=-1)


def root_from_tip(
    wrist_pitch: float,
    wrist_yaw: float,
    *,
    wrist_length: float = WRIST_LENGTH,
    tooltip_offset: Float64 = TOOLTIP_OFFSET,
) -> Float64:
    """Compute the pose (4, 4) of the dVRK's tool tip frame in the root link, from the wrist's angles, rad.

    ``base_from_root @ root_from_tip`` is the arm's ``local/measured_cp``. ``wrist_length`` (A of the wrist yaw joint,
    m) and ``tooltip_offset`` (4, 4) are those of the tool's description.
    """
    pitch = DHJoint(alpha=-pi / 2, a=0.0, theta=-pi / 2, d=0.0)
    yaw = DHJoint(alpha=-pi / 2, a=wrist_length, theta=-pi / 2, d=0.0)
    by_pitch, by_yaw = _row_transforms((pitch, yaw), np.array([wrist_pitch, wrist_yaw]))
    return np.asarray(by_pitch @ by_yaw @ tooltip_offset)


def stated_kinematics(configs: Iterable[Mapping[str, Any]]) -> tuple[Arm, float] | None:
    """Return arm and roll offset (m) of the first of several results' settings that state both; None if none does."""
    for config in configs:
        stated = config.get("instrument")
        if isinstance(stated, dict) and stated.get("arm") in INSERTION_OFFSET:
            offset = stated.get("roll_offset")
            if isinstance(offset, float):
                return stated["arm"], offset
    return None


def find_camera_from_base(
    camera_from_root: Float64, readings: Mapping[str, float], arm: Arm, *, roll_offset: float
) -> Float64 | None:
    """Return camera_from_base (4, 4) from the root's pose (4, 4) and the outer joints' readings (rad, m).

    None if one of the outer joints has no reading. ``roll_offset`` is D of the tool's roll joint, m.
    """
    if any(name not in readings for name in OUTER_JOINTS):
        return None
    return np.asarray(camera_from_root @ inverse(base_from_root(readings, arm, roll_offset=roll_offset)))


def _values(outer: Mapping[str, ArrayLike] | ArrayLike) -> Float64:
    """Convert joint values to an array (..., 4) in the order of ``OUTER_JOINTS``."""
    if isinstance(outer, Mapping):
        missing = [name for name in OUTER_JOINTS if name not in outer]
        if missing:
            raise InputError(f"outer joints: expected {', '.join(OUTER_JOINTS)}, got no {', '.join(missing)}")
        columns = [np.asarray(outer[name], dtype=np.float64) for name in OUTER_JOINTS]
        return np.stack(np.broadcast_arrays(*columns), axis=-1)
    values = np.asarray(outer, dtype=np.float64)
    if values.ndim == 0 or values.shape[-1] != len(OUTER_JOINTS):
        raise InputError(
            f"outer joints: expected {len(OUTER_JOINTS)} values ({', '.join(OUTER_JOINTS)}) in the last axis, "
            f"got an array of shape {values.shape}"
        )
    return values


def _row_transforms(rows: Sequence[DHJoint], values: Float64) -> Float64:
    """Compute the transforms (R, ..., 4, 4) of R DH rows at joint values (..., R)."""
    alpha, a, theta, d, prismatic = (np.array(column) for column in zip(*rows, strict=True))
    theta, d = np.where(prismatic, theta, theta + values), np.where(prismatic, d + values, d)
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    out = np.zeros((*values.shape, 4, 4))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 3] = c, -s, a
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2], out[..., 1, 3] = s * ca, c * ca, -sa, -sa * d
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2], out[..., 2, 3] = s * sa, c * sa, ca, ca * d
    out[..., 3, 3] = 1.0
    return np.moveaxis(out, -3, 0)
