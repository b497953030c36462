"""Selection of modes: distinct local optima of the pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import rotation_angle

Float64 = NDArray[np.float64]


class HasPose(Protocol):
    """An object with a pose, joints and a score."""

    @property
    def camera_from_root(self) -> Float64:
        """(4, 4) pose of the root in the camera, m."""

    @property
    def joints(self) -> Float64:
        """(J,) joint values, rad."""

    @property
    def score(self) -> float:
        """Loss or negative log-likelihood: lower is better."""


@dataclass(frozen=True, eq=False)
class Posed:
    """A pose (4, 4), joints (J,) and, where they have one, a score, as `HasPose`."""

    camera_from_root: Float64
    joints: Float64
    score: float = 0.0


P = TypeVar("P", bound=HasPose)


_ANGLE, _JOINT = float(np.deg2rad(15)), float(np.deg2rad(25))  # between poses of the same mode, at most


def are_distinct(a: HasPose, b: HasPose, angle: float = _ANGLE, joint: float = _JOINT) -> bool:
    """Return whether two poses differ by more than ``angle`` in rotation or more than ``joint`` in any joint, rad."""
    return bool(_are_distinct(a.camera_from_root, a.joints, b.camera_from_root, b.joints, angle, joint))


def _are_distinct(
    pose: Float64, joints: Float64, poses: Float64, other_joints: Float64, angle: float, joint: float
) -> NDArray[np.bool_]:
    """Return which of several poses (..., 4, 4) with joints (..., J) are distinct from one pose (4, 4), joints (J,)."""
    turned = rotation_angle(pose, poses) > angle
    return np.asarray(turned | (np.abs(other_joints - joints).max(axis=-1, initial=0.0) > joint))


def best_per_mode(
    candidates: Sequence[P], *, angle: float = _ANGLE, joint: float = _JOINT, most: int | None = None
) -> list[P]:
    """Select the best candidate of each mode, sorted by score, at most ``most``.

    Candidates belong to the same mode if they are not distinct by the thresholds ``angle`` and ``joint``, rad.
    """
    left = sorted(candidates, key=lambda c: c.score)
    poses = np.array([candidate.camera_from_root for candidate in left])
    joints = np.array([candidate.joints for candidate in left])
    kept: list[P] = []
    while left and len(kept) != most:
        kept.append(left[0])
        distinct = np.flatnonzero(_are_distinct(poses[0], joints[0], poses, joints, angle, joint))
        left, poses, joints = [left[i] for i in distinct], poses[distinct], joints[distinct]
    return kept
