"""Ends of a mask: the jaw tips, as the contour points farthest from the shaft, and a cut along a straight line.

A cut is that of a crop, a box or the edge of a tile. It leaves the whole mask on one side of a line, and part of its
outline exactly on that line. This also holds for the edges of the shaft and of the jaws, but there the silhouette of
the correct pose is straight as well. For a mask that lacks part of the instrument, the fitted silhouette ends near the
cut with the jaws or the wrist, whose outline is not straight. The test is therefore how far the silhouette deviates
from a straight line along the cut.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes import _kernel
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.quantiles import median
from dvrk_cmaes.evidence.shaft_edges import Contour, ShaftEdges
from dvrk_cmaes.geometry import Bool, Float64, Indices
from dvrk_cmaes.instrument import Instrument

_LEAST_BORDER = 5  # pixels of a mask at the border of the image, from which on the instrument comes in there
_LEAST_TIP_DISTANCE = 8.0  # px between two separate tips


def distal_direction(mask: Bool, edges: ShaftEdges, contour: Contour, camera: Camera) -> tuple[Float64, bool]:
    """Find the unit vector (2,) along the shaft towards the jaws, in the undistorted image, and whether that is sure.

    The instrument enters the image at its border, so it points away from the mask's pixels on the image border. If the
    mask has fewer than five of these, the vector points to the side on which the contour reaches farther from the
    middle of the edges, which is not sure: a black border or another tool may hide the rest of either side.
    """
    axis = edges.ends[0, 1] - edges.ends[0, 0]
    axis = axis / np.linalg.norm(axis)
    middle = edges.ends.mean(axis=(0, 1))
    border = _border_pixels(mask)
    if len(border) < _LEAST_BORDER:
        along = (contour.ideal - middle) @ axis
        return np.asarray(axis if along.max() > -along.min() else -axis), False
    ideal = camera.normalise(border.astype(np.float64)) * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    entry = np.array([median(ideal[:, 0]), median(ideal[:, 1])])
    return np.asarray(axis if (entry - middle) @ axis < 0 else -axis), True


def _border_pixels(mask: Bool) -> Indices:
    """Return the pixels (N, 2), u and v, of a mask at the border of the image, without searching all of it."""
    height, width = mask.shape
    found = [(u, v) for v in {0, height - 1} for u in np.flatnonzero(mask[v])]
    found += [(u, v) for u in {0, width - 1} for v in np.flatnonzero(mask[1:-1, u]) + 1]
    return np.array(found, dtype=np.intp).reshape(-1, 2)


def find_tips(
    mask: Bool, contour: Contour, edges: ShaftEdges | None, camera: Camera, ignore: Bool | None
) -> Float64 | str:
    """Locate the jaw tips, (2, 2) px; returns the reason, in words, if they cannot be found.

    The tips are the contour points farthest from the shaft's distal end. If no second tip is separated from the first
    by background, the first is returned twice.
    """
    if edges is None:
        return "without the shaft's edges it is ambiguous which end is distal"
    direction, _ = distal_direction(mask, edges, contour, camera)
    ends = edges.ends.reshape(-1, 2)
    foot = ends[np.argsort(-(ends @ direction))[:2]].mean(axis=0)
    distal = np.flatnonzero((contour.ideal - foot) @ direction > -20)
    if len(distal) < 20:
        return "too little of the mask lies beyond the shaft"
    away = np.linalg.norm(contour.ideal[distal] - foot, axis=1)
    first = distal[int(away.argmax())]
    tip = contour.pixels[first]
    margin = 6.0
    if (tip < margin).any() or (tip > [camera.width - 1 - margin, camera.height - 1 - margin]).any():
        return "the farthest point of the mask lies at the image border"
    column, row = np.rint(tip).astype(int)
    if ignore is not None and ignore[max(row - 7, 0) : row + 8, max(column - 7, 0) : column + 8].any():
        return "the farthest point of the mask lies at an ignored region"
    # The second tip is another distant point; at least half of the line between the two must lie outside the mask.
    far = distal[np.argsort(-away, kind="stable")][: int((away > 0.6 * away.max()).sum())]
    others = contour.pixels[far[np.linalg.norm(contour.pixels[far] - tip, axis=1) > _LEAST_TIP_DISTANCE]]
    share = np.linspace(0.1, 0.9, 17)[:, None]
    column, row = np.rint(tip + share * (others[:, None] - tip)).astype(int).transpose(2, 0, 1)
    separate = np.flatnonzero(mask[row, column].mean(axis=1) < 0.5)
    return np.stack([tip, others[separate[0]] if len(separate) else tip])


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
