"""Fit of a straight circular cylinder to part of a mesh: axis, radius and ends.

The initial direction is the one most nearly perpendicular to the face normals. The mesh is cut into plane sections
across that direction. The longest run of consecutive round sections of equal width on a common line is the cylinder,
and the line through their centres is the direction of the next iteration. Flanges (wider), clevises (not round) and
cones (of changing width) are not part of the run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.sections import Section, Slicer, edges_of

_SECTIONS = 96
_ITERATIONS = 3
_BISECTIONS = 16
_ROUNDNESS = 0.94  # least; a regular octagon has 0.95
_RADIUS_CHANGE = 0.01  # largest, as a fraction of the radius
_CENTRE_SHIFT = 0.05  # largest, as a fraction of the radius
_LEAST_LENGTH = 6.0  # radii; a shorter cylinder is not a shaft


class Cylinder(NamedTuple):
    """A straight circular cylinder, lengths in metres.

    Parameters
    ----------
    point : (3,)
        The point of the axis nearest to the frame's origin.
    direction : (3,)
        Unit vector along the axis; its sign is arbitrary.
    radius
        Half the width of the silhouette, averaged over all viewing directions.
    low, high
        Coordinates of the ends along ``direction`` from ``point``.
    """

    point: Float64
    direction: Float64
    radius: float
    low: float
    high: float


def find_cylinder(vertices: Float64, faces: NDArray[np.int32]) -> Cylinder | None:
    """Find the longest straight circular cylinder in a mesh; None if none is at least three diameters long.

    Parameters
    ----------
    vertices : (V, 3)
        In metres.
    faces : (F, 3)
        Vertex indices.
    """
    edges = edges_of(faces)
    cylinder: Cylinder | None = None
    direction = _direction_across_normals(vertices, faces)
    for _ in range(_ITERATIONS):
        cylinder = _fit_about(vertices, edges, direction)
        if cylinder is None:
            return None
        direction = cylinder.direction
    return cylinder


def _direction_across_normals(vertices: Float64, faces: NDArray[np.int32]) -> Float64:
    """Return the direction (3,) most nearly perpendicular to the face normals, weighted by face area."""
    corners = vertices[faces]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(doubled, axis=1)
    _, vectors = np.linalg.eigh((doubled / np.maximum(areas, 1e-30)[:, None]).T @ doubled)
    return np.asarray(vectors[:, 0])


def _fit_about(vertices: Float64, edges: NDArray[np.int32], direction: Float64) -> Cylinder | None:
    """Fit a cylinder about an approximate direction."""
    slicer = Slicer(vertices, edges, direction)
    step = (slicer.high - slicer.low) / _SECTIONS
    heights = slicer.low + step * (np.arange(_SECTIONS) + 0.5)
    sections = [slicer.at(float(height)) for height in heights]
    run = _longest_run(sections)
    if run is None:
        return None
    within = [section for section in sections[run] if section is not None]
    radius = float(np.median([section.half_width for section in within]))
    centres = np.stack([section.centre for section in within])
    slope, middle = np.zeros(2), centres.mean(axis=0)
    if len(within) > 2:
        fitted = np.polynomial.polynomial.polyfit(heights[run] - heights[run].mean(), centres, 1)
        middle, slope = fitted[0], fitted[1]

    def inside_at(height: float) -> bool:
        section = slicer.at(height)
        line = middle + slope * (height - heights[run].mean())
        return section is not None and _matches(section, radius, line)

    low = _bisect_end(inside_at, float(heights[run][0]), max(float(heights[run][0]) - step, slicer.low))
    high = _bisect_end(inside_at, float(heights[run][-1]), min(float(heights[run][-1]) + step, slicer.high))
    if high - low < _LEAST_LENGTH * radius:
        return None
    point = middle @ slicer.basis + heights[run].mean() * direction
    refined = direction + slope @ slicer.basis
    refined /= np.linalg.norm(refined)
    foot = point - (point @ refined) * refined
    return Cylinder(foot, refined, radius, low, high)


def _matches(section: Section, radius: float, centre: Float64) -> bool:
    """Whether a section is round and has this radius and this centre (2,), within the tolerances."""
    return (
        section.roundness >= _ROUNDNESS
        and abs(section.half_width - radius) <= _RADIUS_CHANGE * radius
        and float(np.linalg.norm(section.centre - centre)) <= _CENTRE_SHIFT * radius
    )


def _longest_run(sections: list[Section | None]) -> slice | None:
    """Return the longest run of consecutive round sections, each like the previous one and as wide as the first."""
    best: slice | None = None
    start = 0
    for index, section in enumerate(sections):
        if section is None or section.roundness < _ROUNDNESS:
            start = index + 1
            continue
        first, before = sections[start], sections[max(index - 1, start)]
        if (
            first is None
            or before is None
            or abs(section.half_width - first.half_width) > _RADIUS_CHANGE * first.half_width
            or not _matches(section, before.half_width, before.centre)
        ):
            start = index
        if best is None or index + 1 - start > best.stop - best.start:
            best = slice(start, index + 1)
    return best


def _bisect_end(inside_at: Callable[[float], bool], inside: float, outside: float) -> float:
    """Find by bisection the end of the cylinder between a height inside and a height outside it."""
    for _ in range(_BISECTIONS):
        middle = (inside + outside) / 2.0
        inside, outside = (middle, outside) if inside_at(middle) else (inside, middle)
    return inside
