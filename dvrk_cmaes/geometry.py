"""Rigid transforms as (..., 4, 4) arrays. A transform named ``a_from_b`` maps points in frame b to frame a."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes import _kernel

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Image = NDArray[np.uint8]
Indices = NDArray[np.intp]


def skew(v: Float64) -> Float64:
    """Return the cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def cross(a: Float64, b: Float64) -> Float64:
    """Return the cross product of two vectors (3,); np.cross takes twenty times as long for a single one."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def exp_rotation(rotvec: ArrayLike) -> Float64:
    """Convert rotation vectors (..., 3), rad, to rotation matrices (..., 3, 3) by Rodrigues' formula."""
    return _kernel.exp_rotation(np.asarray(rotvec, dtype=np.float64))


def log_rotation(rotation: ArrayLike) -> Float64:
    """Convert rotation matrices (..., 3, 3) to rotation vectors (..., 3), rad, of length at most pi."""
    return _kernel.log_rotation(np.asarray(rotation, dtype=np.float64))


def transform(rotation: ArrayLike, translation: ArrayLike) -> Float64:
    """Build transforms (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3), m."""
    r, t = np.asarray(rotation, dtype=np.float64), np.asarray(translation, dtype=np.float64)
    out = np.zeros((*np.broadcast(r[..., 0], t).shape[:-1], 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = r, t, 1.0
    return out


def moved(pose: Float64, change: ArrayLike) -> Float64:
    """Apply small changes (..., 6) = [tx ty tz rx ry rz], m and rad, in the body's own axes, to poses (..., 4, 4).

    Further columns of the changes are passed over.
    """
    return _kernel.moved(*_together(pose, 2, np.asarray(change, dtype=np.float64), 1))


def in_parent(pose: Float64, covariance: Float64) -> Float64:
    """Return a covariance (6 + J, 6 + J) of changes along and about a body's own axes in the axes of its ``pose``.

    ``pose`` (4, 4) maps the body's points to its parent; the J further axes stay as they are.
    """
    turn = np.eye(len(covariance))
    turn[:3, :3] = turn[3:6, 3:6] = pose[:3, :3]
    return np.asarray(turn @ covariance @ turn.T)


def change_between(pose: Float64, other: Float64) -> Float64:
    """Compute the small changes (..., 6) = [tx ty tz rx ry rz] with ``moved(pose, change) == other``."""
    return _kernel.change_between(*_together(pose, 2, other, 2))


def _together(one: Float64, axes: int, other: Float64, of_other: int) -> tuple[Float64, Float64]:
    """Broadcast the leading axes of two arrays, of which the kernel takes a single row or as many as of the other."""
    leading, with_other = one.shape[:-axes], other.shape[:-of_other]
    if not leading or not with_other or leading == with_other:
        return one, other
    shape = np.broadcast_shapes(leading, with_other)
    rows = one.shape[-axes:], other.shape[-of_other:]
    return np.broadcast_to(one, shape + rows[0]), np.broadcast_to(other, shape + rows[1])


def adjoint(pose: Float64) -> Float64:
    """Return the adjoint (..., 6, 6) of poses ``a_from_b``: it converts small changes [t, r] in b's axes to a's."""
    r, t = pose[..., :3, :3], pose[..., :3, 3]
    out = np.zeros((*pose.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = r
    out[..., :3, 3:] = skew(t) @ r
    return out


def apply(target_from_source: Float64, points: Float64) -> Float64:
    """Map points (..., 3), m, from the source frame into the target frame.

    ``target_from_source`` is one transform (4, 4), or one (..., 4, 4) for each set of points (..., N, 3).
    """
    rotation = np.swapaxes(target_from_source[..., :3, :3], -1, -2)
    single = target_from_source.ndim == 2
    translation = target_from_source[:3, 3] if single else target_from_source[..., None, :3, 3]
    return np.asarray(points @ rotation + translation)


def inverse(pose: Float64) -> Float64:
    """Invert rigid transforms (..., 4, 4)."""
    r = np.swapaxes(pose[..., :3, :3], -1, -2)
    return transform(r, -(r @ pose[..., :3, 3:])[..., 0])


def rotation_angle(a: Float64, b: Float64) -> Float64:
    """Compute the angle, rad, (...), between two rotations (..., 3, 3) or between those of two poses (..., 4, 4)."""
    trace = np.einsum("...ij,...ij->...", a[..., :3, :3], b[..., :3, :3])
    return np.asarray(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def frame_along(direction: ArrayLike) -> Float64:
    """Return rotations (..., 3, 3) whose z axes are unit vectors (..., 3); the x axis is a fixed function of z."""
    z = np.asarray(direction, dtype=np.float64)
    helper = np.where(np.abs(z[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    x = (skew(helper) @ z[..., None])[..., 0]
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, (skew(z) @ x[..., None])[..., 0], z], axis=-1)


def rotation_about_z(angle: ArrayLike) -> Float64:
    """Return rotations (..., 3, 3) about z by angles (...), rad."""
    a = np.asarray(angle, dtype=np.float64)
    zero = np.zeros_like(a)
    return exp_rotation(np.stack([zero, zero, a], axis=-1))


@dataclass(frozen=True, eq=False)
class Posed:
    """Where an instrument is in a camera: the unknowns of a frame, or of several candidates.

    ``pose`` (..., 4, 4), m, is camera_from_root, ``joints`` (..., J) are the joint values, rad. Their small changes
    (..., 6 + J) are [tx ty tz rx ry rz, joints], m and rad, the first six in the root's own axes.
    """

    pose: Float64
    joints: Float64

    def moved(self, change: Float64) -> Posed:
        """Return where it is after small changes (..., 6 + J)."""
        return Posed(moved(self.pose, change), self.joints + change[..., 6:])

    def minus(self, other: Posed) -> Float64:
        """Return the small changes (..., 6 + J) that move ``other`` here."""
        return np.concatenate([change_between(other.pose, self.pose), self.joints - other.joints], axis=-1)

    def seen_from(self, view_from_camera: Float64) -> Posed:
        """Return the same in another camera, given the transform (4, 4) from this one to it."""
        return Posed(view_from_camera @ self.pose, self.joints)

    def __len__(self) -> int:
        """Return the number of candidates, the length of the first axis."""
        return len(self.joints)

    def __getitem__(self, index: int | slice | list[int] | NDArray[np.integer | np.bool_] | None) -> Posed:
        """Return one or some of the candidates; with None, this one alone as the only candidate."""
        return Posed(self.pose[index], self.joints[index])

    @staticmethod
    def stacked(candidates: Iterable[Posed]) -> Posed:
        """Return several candidates along a new first axis; there must be at least one."""
        several = list(candidates)
        return Posed(np.stack([each.pose for each in several]), np.stack([each.joints for each in several]))


def quaternion_xyzw(pose: NDArray[np.float64]) -> list[float]:
    """Convert the rotation of a pose (4, 4) to a quaternion x, y, z, w, the order of ROS and SciPy, with w >= 0."""
    vector = log_rotation(pose[:3, :3])
    half = float(np.linalg.norm(vector)) / 2
    return [*(np.sinc(half / np.pi) / 2 * vector).tolist(), float(np.cos(half))]


def project_cylinder(point: Float64, direction: Float64, radius: float) -> Float64:
    """Compute both outline edges of a cylinder as homogeneous lines in normalised coordinates, (..., 2, 3).

    A line (A, B, C) is the set of points with A X + B Y + C = 0. ``point`` (..., 3) on the axis, m, and the unit vector
    ``direction`` (..., 3) are in the camera's frame; ``radius`` is in m. The result is NaN where the camera centre is
    inside the cylinder.
    """
    k = (point * direction).sum(axis=-1, keepdims=True)
    square = (point * point).sum(axis=-1, keepdims=True) - k**2 - radius**2
    with np.errstate(invalid="ignore", divide="ignore"):
        first = radius * (point - direction * k) / np.sqrt(square)
    second = np.cross(direction, point)
    return np.stack([first + second, first - second], axis=-2)


def substituted(pivots: Float64, sides: Float64, coupling: Float64) -> tuple[Float64, Float64]:
    """Solve a block-tridiagonal system whose frames `_kernel.eliminate_chain` has eliminated, for columns (N, M, C).

    Also returns the diagonal blocks (N, M, M) of the inverse.
    """
    solution, blocks = pivots @ sides, pivots.copy()
    for k in range(len(pivots) - 2, -1, -1):
        gain = pivots[k] @ coupling[k]
        solution[k] -= gain @ solution[k + 1]
        blocks[k] += gain @ blocks[k + 1] @ gain.T
    return solution, blocks
