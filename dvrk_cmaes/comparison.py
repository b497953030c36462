"""How far a pose is from the truth, in millimetres and degrees, and whether that is within stated tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

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

    def beyond(self, tolerance: Tolerance) -> list[str]:
        """Say what exceeds its tolerance, in words; nothing where the pose counts as right."""
        measured = {
            "root_mm": self.root_mm,
            "tip_mm": 0.0 if self.tip_mm is None else self.tip_mm,
            "shaft_deg": self.shaft_deg,
            "roll_deg": self.roll_deg,
            "pitch_yaw_deg": max((abs(self.joints_deg.get(n, 0.0)) for n in ("wrist_pitch", "wrist_yaw")), default=0.0),
            "jaw_deg": abs(self.joints_deg.get("jaw", 0.0)),
        }
        found = []
        for name, value in measured.items():
            most = getattr(tolerance, name)
            if not value <= most:  # so that what is not a number exceeds it, too
                quantity, unit = name.rsplit("_", 1)
                found.append(f"{quantity.replace('_', '/')} {value:.2f} {unit} (at most {most:g})")
        return found


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
            instrument.tips([q[name] for name in instrument.joint_names]) @ t[:3, :3].T + t[:3, 3]
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
