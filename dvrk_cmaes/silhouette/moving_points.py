"""Points that are fixed on an instrument, in an image, and how they move there with pose and joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise, starmap
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Posed, adjoint
from dvrk_cmaes.instrument import Instrument

Float64 = NDArray[np.float64]

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
    links, twists = instrument.twists(at.joints)  # (C, L, 4, 4), (C, L, 6, J)
    to_camera = adjoint(at.pose)[:, None]
    motion = np.empty((*twists.shape[:2], 6, 6 + twists.shape[-1]))  # of each link in the camera, by small changes
    motion[..., :6] = to_camera
    np.matmul(to_camera, twists, out=motion[..., 6:])
    counts = _counts(fixed, links.shape[1])
    seen = _in_camera(fixed, at.pose[:, None] @ links, counts)
    depth = seen[:, 2].copy()
    np.maximum(depth, _NEAREST, out=seen[:, 2])
    pixels, gradient = camera.project_along(seen, np.concatenate([group.normals for group in fixed]))
    (x, y, z), (a, b, c) = seen.T, gradient.T
    by_motion = np.stack([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
    jacobian = np.empty((len(seen), motion.shape[-1]))
    edges = accumulate(counts.ravel().tolist(), initial=0)
    for part, of_link in zip(starmap(slice, pairwise(edges)), motion.reshape(-1, *motion.shape[2:]), strict=True):
        np.dot(by_motion[part], of_link, out=jacobian[part])
    ends = accumulate(counts.sum(axis=1).tolist(), initial=0)
    return [MovingPoints(depth[i:k], pixels[i:k], jacobian[i:k]) for i, k in pairwise(ends)]


def placed_points(instrument: Instrument, fixed: FixedPoints, at: Posed) -> Float64:
    """Return points (N, 3), m, at one pose, in the frame of the camera that it is in."""
    camera_from_link = at.pose @ instrument.forward(at.joints)[None]
    return _in_camera([fixed], camera_from_link, _counts([fixed], camera_from_link.shape[1]))


def _counts(fixed: Sequence[FixedPoints], links: int) -> NDArray[np.intp]:
    """Return the number of points of each link at each pose, (C, L)."""
    return np.stack([np.bincount(group.link, minlength=links) for group in fixed])


def _in_camera(fixed: Sequence[FixedPoints], camera_from_link: Float64, counts: NDArray[np.intp]) -> Float64:
    """Return the points of all poses in the camera's frame, (N, 3), given camera_from_link (C, L, 4, 4)."""
    points = np.concatenate([group.points for group in fixed])
    matrices = np.repeat(camera_from_link[..., :3, :].reshape(-1, 3, 4), counts.ravel(), axis=0)
    return np.asarray(np.einsum("nij,nj->ni", matrices[..., :3], points) + matrices[..., 3])
