"""Rotations as other programs want them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation


def quaternion_xyzw(pose: NDArray[np.float64]) -> list[float]:
    """Turn the rotation of a pose (4, 4) into x, y, z, w, the order of ROS and SciPy; w is not negative."""
    quaternion: list[float] = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True).tolist()
    return quaternion


def rotation_vector(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn the rotation of a pose (4, 4) into axis times angle (3,), rad; the angle is at most pi."""
    return np.asarray(Rotation.from_matrix(pose[:3, :3]).as_rotvec(), dtype=np.float64)
