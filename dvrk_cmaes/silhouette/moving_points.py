"""Points that are fixed on an instrument, in an image, and how they move there with pose and joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise, starmap
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument import Instrument

Float64 = NDArray[np.float64]

_STEP = 1e-5  # rad, of central differences of the joints
_NEAREST = 1e-3  # m; points that are nearer, or behind the camera, are taken to be this far away


class FixedPoints(Protocol):
    """N points on links, sorted by link."""

    @property
    def link(self) -> NDArray[np.integer[Any]]:
        """Index of the link of each point, (N,)."""

    @property
    def points(self) -> Float64:
        """The points (N, 3) in the links' frames, m."""

    @property
    def normals(self) -> Float64:
        """Directions (N, 2) in the image along which motion is measured, in units of their lengths."""


@dataclass(frozen=True, eq=False)
class MovingPoints:
    """N points in an image.

    depth : (N,) m. pixels : (N, 2). jacobian : (N, 6 + J), px, derivatives of their displacements along their normals,
    times the normals' lengths, by the small changes of `Posed`.
    """

    depth: Float64
    pixels: Float64
    jacobian: Float64

    @staticmethod
    def joined(groups: Sequence[MovingPoints]) -> MovingPoints:
        """Return the points of several groups, one after another."""
        depth, pixels = (np.concatenate([getattr(group, name) for group in groups]) for name in ("depth", "pixels"))
        return MovingPoints(depth, pixels, np.concatenate([group.jacobian for group in groups]))


def moving_points(
    instrument: Instrument, camera: Camera, fixed: Sequence[FixedPoints], at: Posed
) -> list[MovingPoints]:
    """Project the points of each of C poses, which are in the camera's frame, and compute their motion."""
    ends = accumulate((len(group.points) for group in fixed), initial=0)
    parts = list(starmap(slice, pairwise(ends)))
    in_root, by_joints = _in_root(instrument, fixed, at.joints)
    seen = np.empty_like(in_root)
    for pose, part in zip(at.pose, parts, strict=True):
        np.matmul(in_root[part], pose[:3, :3].T, out=seen[part])
        seen[part] += pose[:3, 3]
    depth = seen[:, 2].copy()
    np.maximum(depth, _NEAREST, out=seen[:, 2])
    pixels, gradient = camera.project_along(seen, np.concatenate([group.normals for group in fixed]))
    in_axes = np.empty_like(gradient)
    for pose, part in zip(at.pose, parts, strict=True):
        np.matmul(gradient[part], pose[:3, :3], out=in_axes[part])
    jacobian = np.empty((len(in_root), 6 + at.joints.shape[1]))
    jacobian[:, :3] = in_axes
    (x, y, z), (a, b, c) = in_root.T, in_axes.T
    jacobian[:, 3], jacobian[:, 4], jacobian[:, 5] = y * c - z * b, z * a - x * c, x * b - y * a
    np.einsum("njk,nk->nj", by_joints, in_axes, out=jacobian[:, 6:])
    return [MovingPoints(depth[part], pixels[part], jacobian[part]) for part in parts]


def placed_points(instrument: Instrument, fixed: FixedPoints, at: Posed) -> Float64:
    """Return points (N, 3), m, at one pose, in the frame of the camera that it is in."""
    camera_from_link = at.pose @ instrument.forward(at.joints)
    of_points = np.repeat(camera_from_link, np.bincount(fixed.link, minlength=len(camera_from_link)), axis=0)
    return np.asarray(np.einsum("nij,nj->ni", of_points[:, :3, :3], fixed.points) + of_points[:, :3, 3])


def _in_root(instrument: Instrument, fixed: Sequence[FixedPoints], joints: Float64) -> tuple[Float64, Float64]:
    """Return the N points of all poses in the root's frame, (N, 3), and their derivatives by the joints, (N, J, 3).

    ``joints`` are (C, J).
    """
    count = joints.shape[1]
    change = _STEP * np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count)])
    root_from_link = instrument.forward(joints[:, None] + change)[..., :3, :]
    by_joint = (root_from_link[:, 1 : 1 + count] - root_from_link[:, 1 + count :]) / (2 * _STEP)
    both = np.concatenate([root_from_link[:, :1], by_joint], axis=1)  # (C, 1 + J, L, 3, 4)
    columns = np.ascontiguousarray(both.transpose(0, 2, 4, 1, 3)).reshape(len(joints), both.shape[2], 4, -1)
    in_root = np.empty((sum(len(group.points) for group in fixed), columns.shape[-1]))
    begin = 0
    for group, of_links in zip(fixed, columns, strict=True):
        edges = np.searchsorted(group.link, np.arange(len(of_links) + 1))
        for link, matrix in enumerate(of_links):
            part = slice(begin + edges[link], begin + edges[link + 1])
            np.matmul(group.points[edges[link] : edges[link + 1]], matrix[:3], out=in_root[part])
            in_root[part] += matrix[3]
        begin += len(group.points)
    return in_root[:, :3], in_root[:, 3:].reshape(-1, count, 3)
