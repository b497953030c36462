"""Plane sections of a mesh, described by their convex hulls, which determine the silhouette."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Float64


class Section(NamedTuple):
    """Measures of the convex hull of a plane section.

    Parameters
    ----------
    centre : (2,)
        Centroid of the area, m, in the plane's basis.
    half_width
        Half the mean width over all directions in the plane, m: perimeter / (2 pi), by Cauchy's formula.
    roundness
        4 pi area / perimeter^2: 1 for a disc, 0.95 for an octagon, 0.79 for a square.
    """

    centre: Float64
    half_width: float
    roundness: float


def plane_basis(normal: Float64) -> Float64:
    """Return two unit vectors (2, 3) that form a right-handed basis with a unit normal (3,)."""
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def edges_of(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the distinct edges of faces (F, 3) as vertex indices (E, 2), the smaller index first."""
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    count = int(pairs.max(initial=0)) + 1
    numbers = np.unique(pairs[:, 0].astype(np.int64) * count + pairs[:, 1])  # much faster than the unique rows
    return np.stack(np.divmod(numbers, count), axis=1).astype(faces.dtype)


class Slicer:
    """Computes plane sections of one mesh perpendicular to a fixed direction.

    Parameters
    ----------
    vertices : (V, 3)
        Vertices of the mesh, m.
    edges : (E, 2)
        Vertex indices.
    direction : (3,)
        Unit normal of the planes.
    """

    def __init__(self, vertices: Float64, edges: NDArray[np.int32], direction: Float64) -> None:
        self.basis = plane_basis(direction)
        heights = vertices @ direction
        self.low, self.high = float(heights.min()), float(heights.max())
        ends = heights[edges]
        upper = np.argmax(ends, axis=1)
        rows = np.arange(len(edges))
        self._bottom, self._top = ends[rows, 1 - upper], ends[rows, upper]
        flat = vertices @ self.basis.T
        self._foot, self._head = flat[edges[rows, 1 - upper]], flat[edges[rows, upper]]

    def at(self, height: float) -> Section | None:
        """Compute the section at a coordinate along the direction, m; None if the plane does not cut the mesh."""
        from scipy.spatial import ConvexHull, QhullError

        cut = (self._bottom <= height) & (self._top > height)
        bottom, top, foot, head = self._bottom[cut], self._top[cut], self._foot[cut], self._head[cut]
        if len(bottom) < 3:
            return None
        points = foot + ((height - bottom) / (top - bottom))[:, None] * (head - foot)
        try:
            hull = ConvexHull(points)
        except QhullError:  # all points lie on a line
            return None
        outline = points[hull.vertices]
        return _section(outline - outline[0], outline[0])


def _section(outline: Float64, start: Float64) -> Section:
    """Measure a convex polygon (N, 2) with ordered corners relative to ``start`` (2,)."""
    following = np.roll(outline, -1, axis=0)
    cross = outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]
    area = cross.sum() / 2.0
    centre = start + ((outline + following) * cross[:, None]).sum(axis=0) / (6.0 * area)
    perimeter = float(np.linalg.norm(following - outline, axis=1).sum())
    return Section(centre, perimeter / (2.0 * np.pi), float(4.0 * np.pi * abs(area) / perimeter**2))
