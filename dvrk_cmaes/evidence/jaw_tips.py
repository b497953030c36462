"""Detection of the two jaw tips in a mask, as the contour points farthest from the shaft."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.quantiles import median
from dvrk_cmaes.evidence.shaft_edges import Contour, ShaftEdges
from dvrk_cmaes.geometry import Bool, Float64, Indices

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
        return "without the shaft's edges there is no telling which end is distal"
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
