"""Where a mask was cut off straight: by a crop, a box, the edge of a tile, whatever shows half an instrument.

A cut leaves the whole mask on one side of a line, and a stretch of its outline exactly on it. The shaft's own edges
and the jaws' do so as well, but there the silhouette of the right pose is straight too. Half an instrument finds a pose
that hides what is missing, whose silhouette must end somewhere near the cut; what ends there are jaws or a wrist, and
their outline is not straight.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.instrument import Instrument

Float64 = NDArray[np.float64]

_BAND = 1.0  # px, how far inside of the line an outline may lie that runs along it
_GAP = 5.0  # px along the line without an outline, at most
_SHORTEST = 0.75  # of a straight stretch, in widths of the shaft: a cut across it is at least one long
_SIDE = 0.25  # of the shortest stretch: the shortest side of the convex hull that gives a line its direction


def shaft_width(instrument: Instrument, camera: Camera, camera_from_root: Float64) -> float | None:
    """Width of the shaft in the image, px, at the root's distance; None without a shaft or behind the camera.

    ``camera_from_root`` is (4, 4).
    """
    depth = float(camera_from_root[2, 3])
    if instrument.shaft is None or depth <= 0:
        return None
    return float(2 * instrument.shaft.radius * np.sqrt(camera.fx * camera.fy) / depth)


def largest_bend(outline: Float64, distances: Float64, width: float) -> float:
    """Range, px, over which the silhouette leaves the mask's outline where that bounds the whole mask straight.

    ``outline`` (N, 2) px are points on the mask's outline, ``distances`` (N,) px those from the silhouette's, negative
    inside; ``width`` px is the shaft's. Of all straight stretches the one with the largest range; shift and turn of the
    silhouette against the stretch do not count. 0 where nothing is straight for long enough.
    """
    largest, shortest = 0.0, _SHORTEST * width
    for points, along in _straight_stretches(outline, shortest):
        line = np.polynomial.polynomial.polyfit(along, distances[points], 1)
        largest = max(largest, float(np.ptp(distances[points] - line[0] - line[1] * along)))
    return largest


def _straight_stretches(outline: Float64, shortest: float) -> list[tuple[NDArray[np.intp], Float64]]:
    """Stretches of an outline along lines that have all of it on one side: their points, and where on the line, px."""
    found: list[tuple[NDArray[np.intp], Float64]] = []
    if len(outline) < 3:
        return found
    corners = cv2.convexHull(outline.astype(np.float32), clockwise=True)[:, 0].astype(np.float64)
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    for k in np.flatnonzero(lengths >= max(_SIDE * shortest, 1.0)):
        way = sides[k] / lengths[k]
        inside = np.abs((outline - corners[k]) @ np.array([way[1], -way[0]]))
        near = np.flatnonzero(inside < _BAND)
        near = near[np.argsort(outline[near] @ way, kind="stable")]
        along = outline[near] @ way
        for piece in np.split(np.arange(len(near)), np.flatnonzero(np.diff(along) > _GAP) + 1):
            if along[piece[-1]] - along[piece[0]] >= shortest:
                found.append((near[piece], along[piece] - along[piece[0]]))
    return found
