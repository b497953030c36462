"""Errors of a pose against the true pose, in millimetres and degrees, and their tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from dvrk_cmaes.evaluate import Tolerance
from dvrk_cmaes.geometry import Float64, apply
from dvrk_cmaes.instrument import Instrument

_TWIN_DEG: Final = 90.0
"""Roll difference from which a pose is rather the mirror twin's than the true one."""


class Measured(NamedTuple):
    """A quantity's error, not negative, and its tolerance ``at_most``, both in ``unit`` (mm or deg)."""

    quantity: str
    unit: str
    error: float
    at_most: float

    @property
    def exceeds(self) -> bool:
        """Whether the error is larger than its tolerance, or NaN."""
        return not self.error <= self.at_most


@dataclass(frozen=True)
class PoseError:
    """Errors of a pose.

    root_mm : distance between the positions of the root's origin.
    tip_mm : mean distance between the positions of the tips (of the end, without a pair of jaws); None without all true
        joints.
    rotation_deg : angle of the whole rotation error.
    shaft_deg, roll_deg : angle between the shaft's directions, and about the shaft.
    joints_deg : found less true, by name.
    farthest_tip_mm : the larger of the tips' distances, where the mean is known.
    """

    root_mm: float
    tip_mm: float | None
    rotation_deg: float
    shaft_deg: float
    roll_deg: float
    joints_deg: dict[str, float]
    farthest_tip_mm: float | None = None

    @property
    def joint_deg(self) -> float | None:
        """Largest difference of a joint without its sign, deg; None without common joints."""
        return max((abs(value) for value in self.joints_deg.values()), default=None)

    @property
    def is_twin(self) -> bool:
        """Whether the pose is rolled so far that it is rather the mirror twin's."""
        return self.roll_deg > _TWIN_DEG

    @property
    def size(self) -> tuple[float, float]:
        """Sort key: distance of the tips, or else of the root, mm; then the roll, deg."""
        return self.root_mm if self.tip_mm is None else self.tip_mm, self.roll_deg

    def measured(self, tolerance: Tolerance) -> list[Measured]:
        """List each quantity's error with its tolerance; that of joints other than the jaw is ``pitch_yaw_deg``."""
        errors = [Measured("root", "mm", self.root_mm, tolerance.root_mm)]
        if self.tip_mm is not None:
            errors.append(Measured("tip", "mm", self.tip_mm, tolerance.tip_mm))
        errors.append(Measured("shaft", "deg", self.shaft_deg, tolerance.shaft_deg))
        errors.append(Measured("roll", "deg", self.roll_deg, tolerance.roll_deg))
        for name, value in self.joints_deg.items():
            most = tolerance.jaw_deg if name == "jaw" else tolerance.pitch_yaw_deg
            errors.append(Measured(name, "deg", abs(value), most))
        return errors


class RotationError(NamedTuple):
    """Angle of a rotation error, of its part that tilts the root's z axis, and of its part about that axis, deg."""

    rotation_deg: float
    shaft_deg: float
    roll_deg: float


def compare_rotations(pose: Float64, true_pose: Float64) -> RotationError:
    """Compare the rotations of two poses (4, 4), by a swing-twist decomposition about the true root's z axis."""
    x, y, z, w = Rotation.from_matrix(true_pose[:3, :3].T @ pose[:3, :3]).as_quat()
    roll = 2 * np.arctan2(z, w)
    swing = 2 * np.arctan2(np.hypot(x, y), np.hypot(z, w))
    return RotationError(
        float(np.degrees(2 * np.arctan2(np.sqrt(x * x + y * y + z * z), abs(w)))),
        float(np.degrees(swing)),
        float(abs(np.degrees((roll + np.pi) % (2 * np.pi) - np.pi))),
    )


def compare_poses(
    instrument: Instrument, estimate: tuple[Float64, Mapping[str, float]], truth: tuple[Float64, Mapping[str, float]]
) -> PoseError:
    """Compare a pose and its joints with the true ones: each is camera_from_root (4, 4) and joints by name, rad."""
    (pose, joints), (true_pose, true_joints) = estimate, truth
    own = {name: joints[name] for name in instrument.joint_names if name in true_joints}
    tips, true_tips = tips_in_camera(instrument, *estimate), tips_in_camera(instrument, *truth)
    return pose_error(pose, true_pose, own, true_joints, tips, true_tips)


def tips_in_camera(instrument: Instrument, pose: Float64, joints: Mapping[str, float]) -> Float64 | None:
    """Return the tips (K, 3) of an instrument at a pose (4, 4), m in the camera; None without all of its joints."""
    if any(name not in joints for name in instrument.joint_names):
        return None
    return np.asarray(apply(pose, instrument.ends([joints[name] for name in instrument.joint_names])))


def pose_error(
    pose: Float64,
    true_pose: Float64,
    joints: Mapping[str, float],
    true_joints: Mapping[str, float],
    tips: Float64 | None,
    true_tips: Float64 | None,
) -> PoseError:
    """Compare a pose (4, 4), its joints and its tips (K, 3) with the true ones, rad and m; joints that both have."""
    turned, apart = compare_rotations(pose, true_pose), None
    if tips is not None and true_tips is not None and tips.shape == true_tips.shape:
        apart = 1e3 * np.linalg.norm(tips - true_tips, axis=1)
    return PoseError(
        root_mm=float(1e3 * np.linalg.norm(pose[:3, 3] - true_pose[:3, 3])),
        tip_mm=None if apart is None else float(apart.mean()),
        rotation_deg=turned.rotation_deg,
        shaft_deg=turned.shaft_deg,
        roll_deg=turned.roll_deg,
        joints_deg={n: float(np.degrees(q - true_joints[n])) for n, q in joints.items() if n in true_joints},
        farthest_tip_mm=None if apart is None else float(apart.max()),
    )
