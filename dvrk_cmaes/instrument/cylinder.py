"""The straight cylinder in a mesh: axis, radius and where it begins and ends.

A first direction comes from the surface: the normals of a cylinder are at right angles to its axis. Sections
across it are compared; the longest run of round ones of one size about one line is the cylinder, and the line
through their centres is the next direction. Flanges (wider), clevises (not round) and cones (changing width)
stay outside the run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.instrument.sections import Section, Slicer, edges_of

_SECTIONS = 96
_ROUNDS = 3  # of: sections, line through the centres
_BISECTIONS = 16
_ROUNDNESS = 0.94  # an octagon passes
_RADIUS_CHANGE = 0.01  # of the radius
_CENTRE_SHIFT = 0.05  # of the radius
_LEAST_LENGTH = 6.0  # radii: a stub shorter than three diameters is no shaft


class Cylinder(NamedTuple):
    """A straight round cylinder, lengths in metres.

    point : (3,) the point of the axis nearest the frame's origin.
    direction : (3,) unit, of either sense.
    radius : half the width of the silhouette, averaged over all directions of view.
    low, high : ends, as coordinates along the direction from the point.
    """

    point: NDArray[np.float64]
    direction: NDArray[np.float64]
    radius: float
    low: float
    high: float


def find_cylinder(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    axis: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
) -> Cylinder | None:
    """Find the longest straight round cylinder in a mesh, None if there is none of three diameters.

    vertices : (V, 3) m. faces : (F, 3). axis : point (3,) and unit direction (3,) if known; else it is found.
    """
    edges = edges_of(faces)
    if axis is not None:
        return _along(vertices, edges, axis[1], fixed=axis[0])
    cylinder: Cylinder | None = None
    direction = _across_the_normals(vertices, faces)
    for _ in range(_ROUNDS):
        cylinder = _along(vertices, edges, direction)
        if cylinder is None:
            return None
        direction = cylinder.direction
    return cylinder


def _across_the_normals(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Direction (3,) most nearly at right angles to the faces, each counted by its area."""
    corners = vertices[faces]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(doubled, axis=1)
    _, vectors = np.linalg.eigh((doubled / np.maximum(areas, 1e-30)[:, None]).T @ doubled)
    return np.asarray(vectors[:, 0])


def _along(
    vertices: NDArray[np.float64],
    edges: NDArray[np.int32],
    direction: NDArray[np.float64],
    fixed: NDArray[np.float64] | None = None,
) -> Cylinder | None:
    """Cylinder about a direction that is roughly known (or exactly: `fixed` is a point on the axis)."""
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

    def belongs(height: float) -> bool:
        section = slicer.at(height)
        line = middle + slope * (height - heights[run].mean())
        return section is not None and _alike(section, radius, line)

    low = _last_inside(belongs, float(heights[run][0]), max(float(heights[run][0]) - step, slicer.low))
    high = _last_inside(belongs, float(heights[run][-1]), min(float(heights[run][-1]) + step, slicer.high))
    if high - low < _LEAST_LENGTH * radius:
        return None
    if fixed is not None:
        return Cylinder(fixed, direction, radius, low, high)
    point = middle @ slicer.basis + heights[run].mean() * direction
    refined = direction + slope @ slicer.basis
    refined /= np.linalg.norm(refined)
    foot = point - (point @ refined) * refined
    return Cylinder(foot, refined, radius, low, high)


def _alike(section: Section, radius: float, centre: NDArray[np.float64]) -> bool:
    return (
        section.roundness >= _ROUNDNESS
        and abs(section.half_width - radius) <= _RADIUS_CHANGE * radius
        and float(np.linalg.norm(section.centre - centre)) <= _CENTRE_SHIFT * radius
    )


def _longest_run(sections: list[Section | None]) -> slice | None:
    """Longest row of neighbouring round sections, each like the one before and of nearly the first one's size."""
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
            or not _alike(section, before.half_width, before.centre)
        ):
            start = index
        if best is None or index + 1 - start > best.stop - best.start:
            best = slice(start, index + 1)
    return best


def _last_inside(belongs: Callable[[float], bool], inside: float, outside: float) -> float:
    """Narrow down where sections stop belonging to the cylinder, between a height inside and one outside."""
    for _ in range(_BISECTIONS):
        middle = (inside + outside) / 2.0
        inside, outside = (middle, outside) if belongs(middle) else (inside, middle)
    return inside
