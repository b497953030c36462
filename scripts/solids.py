"""Solids of which the bundled instruments are composed: prisms, rods, boxes, tubes and lofts, in millimetres.

The functions wrap manifold3d: outlines are given as arrays, and circles become polygons within CHORD_ERROR.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from manifold3d import CrossSection, FillRule, Manifold, Mesh64, OpType
from numpy.typing import NDArray

Points = NDArray[np.float64]

CHORD_ERROR: Final = 0.002  # mm, largest distance of a polygon from its circle: 0.025 px at 80 mm and f = 1000 px


def sides(radius: float) -> int:
    """Return the number of sides, a multiple of four, of a polygon within CHORD_ERROR of a circle of a radius, mm."""
    return 4 * int(np.ceil(np.pi / np.arccos(1 - CHORD_ERROR / radius) / 4))


def arc(centre: tuple[float, float], half_axes: tuple[float, float], start: float, stop: float) -> Points:
    """Return points (N, 2) on an axis-parallel ellipse from one angle to another (rad), both ends included."""
    steps = max(2, int(np.ceil(sides(max(half_axes)) * abs(stop - start) / (2 * np.pi))))
    angle = np.linspace(start, stop, steps + 1)
    return np.stack([centre[0] + half_axes[0] * np.cos(angle), centre[1] + half_axes[1] * np.sin(angle)], 1)


def bend(start: float, stop: float, radius: float, height: float) -> Points:
    """Return points (N, 2) on a circle that is tangent to y = height at x = start and bends down, until x = stop."""
    angle = np.arcsin((stop - start) / radius)
    return arc((start, height - radius), (radius, radius), np.pi / 2, np.pi / 2 - angle)


def prism(outline: Points, low: float, high: float, axis: str = "z") -> Manifold:
    """Extrude an outline (N, 2) along an axis: (x, y) along z, (x, z) along y, or (y, z) along x."""
    solid = CrossSection([outline], FillRule.NonZero).extrude(high - low).translate((0.0, 0.0, low))
    turned = {
        "z": solid,
        "y": solid.transform(np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0]])).mirror((0.0, 1.0, 0.0)),
        "x": solid.transform(np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0]])),
    }
    return turned[axis]


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Manifold:
    """Make a box from two opposite corners."""
    return Manifold.cube(tuple(b - a for a, b in zip(low, high, strict=True))).translate(low)


def rod(radius: float, low: float, high: float, axis: str = "z", centre: tuple[float, float] = (0.0, 0.0)) -> Manifold:
    """Make a cylinder along an axis; ``centre`` has the same two coordinates as an outline of `prism`."""
    return prism(arc(centre, (radius, radius), 0.0, 2 * np.pi)[:-1], low, high, axis)


def rounded_rectangle(low: Points, high: Points, radii: Sequence[float], steps: Sequence[int]) -> Points:
    """Return an outline (N, 2), anticlockwise from the lower right corner; a corner with zero steps is not rounded."""
    corners = [(high[0], low[1]), (high[0], high[1]), (low[0], high[1]), (low[0], low[1])]
    inward = [(-1, 1), (-1, -1), (1, -1), (1, 1)]
    parts = []
    for k, (corner, sign) in enumerate(zip(corners, inward, strict=True)):
        if steps[k] == 0:
            parts.append(np.array([corner]))
            continue
        angle = np.pi / 2 * (k - 1 + np.linspace(0, 1, steps[k] + 1))
        centre = np.array(corner) + radii[k] * np.array(sign)
        parts.append(centre + radii[k] * np.stack([np.cos(angle), np.sin(angle)], 1))
    return np.concatenate(parts)


def revolve(outline: Points, radius: float) -> Manifold:
    """Revolve an outline (N, 2) of r and z about the z axis, with the number of sides for a radius, mm."""
    return CrossSection([outline], FillRule.NonZero).revolve(sides(radius))


def loft(sections: Points) -> Manifold:
    """Make a solid whose surface connects consecutive convex rings, ``sections`` (S, N, 3), and closes the ends."""
    count, n = sections.shape[:2]
    k, j = np.meshgrid(np.arange(count - 1), np.arange(n), indexing="ij")
    a, b = k * n + j, k * n + (j + 1) % n
    ring = np.arange(n)
    first, last, end = count * n, count * n + 1, (count - 1) * n
    faces = np.concatenate([
        np.stack([a, b, b + n], -1).reshape(-1, 3),
        np.stack([a, b + n, a + n], -1).reshape(-1, 3),
        np.stack([np.full(n, first), (ring + 1) % n, ring], 1),
        np.stack([np.full(n, last), end + ring, end + (ring + 1) % n], 1),
    ])  # fmt: skip
    vertices = np.concatenate([sections.reshape(-1, 3), sections[0].mean(0)[None], sections[-1].mean(0)[None]])
    corner = vertices[faces]
    if np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum() < 0:
        faces = faces[:, ::-1]
    return Manifold(Mesh64(vertices, np.ascontiguousarray(faces, dtype=np.uint64)))


def tube(path: Sequence[tuple[float, float, float]], radius: float) -> Manifold:
    """Make a tube of a radius around a path of straight pieces, with round ends and bends."""
    balls = [Manifold.sphere(radius, 8).translate(point) for point in path]
    pieces = [Manifold.batch_hull([one, other]) for one, other in pairwise(balls)]
    return Manifold.batch_boolean(pieces, OpType.Add)
