"""How far a pose is from the truth, in millimetres and degrees, and whether that is within stated tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dvrk_cmaes.geometry import apply
from dvrk_cmaes.instrument import Instrument

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Tolerance:
    """Largest errors of an answer that counts as right, mm and deg.

    ``shaft_deg`` is between the directions of the root's z axis, ``roll_deg`` about it.
    """

    root_mm: float = 0.5
    tip_mm: float = 0.5
    shaft_deg: float = 1.5
    roll_deg: float = 3.0
    pitch_yaw_deg: float = 3.0
    jaw_deg: float = 3.0


class Measured(NamedTuple):
    """A quantity's error, at least zero, and the largest that is allowed, in its unit (mm or deg)."""

    quantity: str
    unit: str
    error: float
    at_most: float

    @property
    def exceeds(self) -> bool:
        """Whether the error is too large; what is not a number is, too."""
        return not self.error <= self.at_most


@dataclass(frozen=True)
class PoseError:
    """Errors of a pose.

    ``root_mm``: of the root's origin. ``tip_mm``: of the jaw tips, mean of the two; None without jaws or
    without all true joints.
    ``rotation_deg``: whole angle; ``shaft_deg`` and ``roll_deg``: of the shaft's direction, and about it.
    ``joints_deg``: found less true, by name.
    """

    root_mm: float
    tip_mm: float | None
    rotation_deg: float
    shaft_deg: float
    roll_deg: float
    joints_deg: dict[str, float]

    def measured(self, tolerance: Tolerance) -> list[Measured]:
        """Each quantity with what is allowed; joints other than the jaw as pitch and yaw."""
        found = [Measured("root", "mm", self.root_mm, tolerance.root_mm)]
        if self.tip_mm is not None:
            found.append(Measured("tip", "mm", self.tip_mm, tolerance.tip_mm))
        found.append(Measured("shaft", "deg", self.shaft_deg, tolerance.shaft_deg))
        found.append(Measured("roll", "deg", self.roll_deg, tolerance.roll_deg))
        for name, value in self.joints_deg.items():
            most = tolerance.jaw_deg if name == "jaw" else tolerance.pitch_yaw_deg
            found.append(Measured(name, "deg", abs(value), most))
        return found

    def beyond(self, tolerance: Tolerance) -> list[str]:
        """Say what exceeds its tolerance, in words; nothing where the pose counts as right."""
        return [
            f"{one.quantity} {one.error:.2f} {one.unit} (at most {one.at_most:g})"
            for one in self.measured(tolerance)
            if one.exceeds
        ]


def compare_poses(
    instrument: Instrument,
    found: tuple[Float64, Mapping[str, float]],
    truth: tuple[Float64, Mapping[str, float]],
) -> PoseError:
    """Compare a pose and its joints with the true ones: each is camera_from_root (4, 4) and joints by name, rad."""
    (pose, joints), (true_pose, true_joints) = found, truth
    # The error's rotation, in the true root's axes, as a swing of its z axis after a turn about it.
    x, y, z, w = Rotation.from_matrix(true_pose[:3, :3].T @ pose[:3, :3]).as_quat()
    roll = 2 * np.arctan2(z, w)
    swing = 2 * np.arctan2(np.hypot(x, y), np.hypot(z, w))
    tip_mm = None
    if instrument.jaw_tips and all(name in true_joints for name in instrument.joint_names):
        ends = [
            apply(t, instrument.tips([q[name] for name in instrument.joint_names]))
            for t, q in ((pose, joints), (true_pose, true_joints))
        ]
        tip_mm = float(1e3 * np.linalg.norm(ends[0] - ends[1], axis=1).mean())
    return PoseError(
        root_mm=float(1e3 * np.linalg.norm(pose[:3, 3] - true_pose[:3, 3])),
        tip_mm=tip_mm,
        rotation_deg=float(np.degrees(2 * np.arctan2(np.sqrt(x * x + y * y + z * z), abs(w)))),
        shaft_deg=float(np.degrees(swing)),
        roll_deg=float(abs(np.degrees((roll + np.pi) % (2 * np.pi) - np.pi))),
        joints_deg={
            name: float(np.degrees(joints[name] - true_joints[name]))
            for name in instrument.joint_names
            if name in true_joints
        },
    )
