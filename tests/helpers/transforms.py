"""Rigid transforms (..., 4, 4), by SciPy, for tests that compare with what the program computes by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation


def exp_rotation(rotvec: Any) -> np.ndarray:
    """Convert rotation vectors (..., 3), rad, to matrices (..., 3, 3)."""
    vectors = np.asarray(rotvec, float)
    return Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(*vectors.shape, 3)


def transform(rotation: Any, translation: Any) -> np.ndarray:
    """Build transforms (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3), m."""
    r, t = np.asarray(rotation, float), np.asarray(translation, float)
    out = np.zeros((*np.broadcast_shapes(r.shape[:-2], t.shape[:-1]), 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = r, t, 1.0
    return out


def inverse(pose: np.ndarray) -> np.ndarray:
    """Invert transforms (..., 4, 4)."""
    return np.linalg.inv(pose)


def apply(target_from_source: np.ndarray, points: Any) -> np.ndarray:
    """Map points (..., N, 3) or (3,) by a transform (4, 4), or by one for each set of points."""
    rotation, translation = target_from_source[..., :3, :3], target_from_source[..., :3, 3]
    if target_from_source.ndim > 2:
        translation = translation[..., None, :]
    return np.asarray(points) @ np.swapaxes(rotation, -1, -2) + translation


def moved(pose: np.ndarray, change: Any) -> np.ndarray:
    """Apply small changes (..., 6) = [tx ty tz rx ry rz], m and rad, in the body's own axes, to poses (..., 4, 4)."""
    change = np.asarray(change, float)[..., :6]
    return pose @ transform(exp_rotation(change[..., 3:]), change[..., :3])


def change_between(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Give the small changes (..., 6) with ``moved(pose, change) == other``."""
    step = np.linalg.inv(pose) @ other
    turns = Rotation.from_matrix(step[..., :3, :3].reshape(-1, 3, 3)).as_rotvec().reshape(*step.shape[:-2], 3)
    return np.concatenate([step[..., :3, 3], turns], axis=-1)


def rotation_angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Give the angle (...), rad, between two rotations (..., 3, 3) or those of two poses (..., 4, 4)."""
    trace = np.einsum("...ij,...ij->...", a[..., :3, :3], b[..., :3, :3])
    return np.asarray(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def lookat_pose(alpha: Any, beta: Any, gamma: Any, distance: Any) -> np.ndarray:
    """Give camera_from_root (..., 4, 4) with the rotation R_y(gamma) R_x(alpha) R_z(beta) at [0, 0, distance]."""
    a, b, g, d = np.broadcast_arrays(*(np.asarray(value, float) for value in (alpha, beta, gamma, distance)))
    zero = np.zeros_like(a)
    turns = [exp_rotation(np.stack(axes, axis=-1)) for axes in ((zero, g, zero), (a, zero, zero), (zero, zero, b))]
    return transform(turns[0] @ turns[1] @ turns[2], np.stack([zero, zero, d], axis=-1))
