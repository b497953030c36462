"""Detection of masks that are cut off along a straight line, by a crop, a box or the edge of a tile.

A cut leaves the whole mask on one side of a line, and part of its outline exactly on that line. This also holds for the
edges of the shaft and of the jaws, but there the silhouette of the correct pose is straight as well. For a mask that
lacks part of the instrument, the fitted silhouette ends near the cut with the jaws or the wrist, whose outline is not
straight. The test is therefore how far the silhouette deviates from a straight line along the cut.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes import _kernel
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument import Instrument

_BAND = 1.0  # px, largest distance from the line of outline points that count as lying on it
_LARGEST_GAP = 5.0  # px along the line without outline points
_LEAST_LENGTH = 0.75  # of a straight stretch, in widths of the shaft; a cut across the shaft has at least one
_LEAST_SIDE = 0.25  # of a side of the convex hull that defines a line, in least lengths of a stretch


def shaft_width(instrument: Instrument, camera: Camera, camera_from_root: Float64) -> float | None:
    """Compute the width of the shaft in the image, px, at the depth of the root.

    ``camera_from_root`` is (4, 4). Returns None for an instrument without a shaft or a root behind the camera.
    """
    depth = float(camera_from_root[2, 3])
    if instrument.shaft is None or depth <= 0:
        return None
    return float(2 * instrument.shaft.radius * np.sqrt(camera.fx * camera.fy) / depth)


def largest_bend(outline: Float64, distances: Float64, width: float) -> float:
    """Compute the largest deviation, px, of the silhouette from a straight line along straight stretches of the mask.

    ``outline`` (N, 2) px are points on the mask's outline; ``distances`` (N,) px are their signed distances to the
    silhouette's outline, negative inside; ``width`` px is that of the shaft. For each straight stretch of outline that
    has the whole mask on one side, a line is fitted to the distances, which removes shift and rotation, and the range
    of the residuals is taken. Returns the largest range, or 0 if no stretch is long enough.
    """
    largest, shortest = 0.0, _LEAST_LENGTH * width
    for points, along in _straight_stretches(outline, shortest):
        off, centred = distances[points], along - along.mean()
        slope = (centred @ off) / (centred @ centred)  # of the least squares line; its offset does not change the range
        largest = max(largest, float(np.ptp(off - slope * centred)))
    return largest


def _straight_stretches(outline: Float64, shortest: float) -> list[tuple[NDArray[np.int64], Float64]]:
    """Find straight stretches of an outline that have all of it on one side.

    Returns for each, of at least ``shortest`` px, the indices of its points and their positions along the line, px.
    """
    if len(outline) < 3:
        return []
    corners = cv2.convexHull(outline.astype(np.float32), clockwise=True)[:, 0].astype(np.float64)
    side = max(_LEAST_SIDE * shortest, 1.0)
    return _kernel.straight_stretches(outline, corners, _BAND, _LARGEST_GAP, shortest, side)
