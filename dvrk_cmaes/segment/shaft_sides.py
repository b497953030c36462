"""Log-odds of instrument by the straight sides of the shaft, fitted to a rough mask.

In the dark corners of an endoscope's image, cloth and tissue are as grey as the shaft, and a mask found by colours
leaks into them. The sides of the shaft are straight up to the image's border, which limits the mask there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.shaft_edges import find_contour, find_shaft_edges
from dvrk_cmaes.geometry import Bool, Float32

_FOCAL = 1.2  # assumed focal length, in longer sides of the image; its exact value matters little to find the sides
_RADIUS = 0.004  # m, assumed radius of the shaft, likewise
_SLACK = 1.5  # px on either side of a line, in which the log-odds are 0
_STEEPNESS = 1.0  # log-odds per px beyond that
_LARGEST = 4.0  # bound of the log-odds


def shaft_log_odds(mask: Bool) -> Float32 | None:
    """Return log-odds of instrument (H, W) by the shaft's sides in a mask (H, W), or None if no sides are found.

    They are 0 distally of the more proximal of the two sides' distal ends, where the wrist begins.
    """
    height, width = mask.shape
    focal = _FOCAL * max(height, width)
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    pairs = find_shaft_edges(mask, find_contour(mask, camera), camera, _RADIUS)
    if isinstance(pairs, str):
        return None
    lines = pairs[0].planes @ np.linalg.inv(camera.matrix)
    lines /= np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    v, u = np.mgrid[:height, :width].astype(np.float32)
    first, second = (line[0] * u + line[1] * v + line[2] for line in lines)  # px, positive outside
    outside = np.maximum(first, second)
    pull = -_STEEPNESS * np.sign(outside) * np.maximum(np.abs(outside) - _SLACK, 0)
    along = _inward(lines)
    stretch = pairs[0].ends @ along
    ends = stretch.min(axis=1), stretch.max(axis=1)
    if _comes_from_start(pairs[0].ends, along, (height, width)):
        on_shaft = along[0] * u + along[1] * v < min(ends[1])
    else:
        on_shaft = along[0] * u + along[1] * v > max(ends[0])
    return np.asarray(np.where(on_shaft, np.clip(pull, -_LARGEST, _LARGEST), 0), np.float32)


def _inward(lines: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean direction (2,), a unit vector, along two lines (2, 3) with opposite outward normals."""
    direction = np.array([-lines[0, 1], lines[0, 0]]) - np.array([-lines[1, 1], lines[1, 0]])
    return np.asarray(direction / np.linalg.norm(direction))


def _comes_from_start(ends: NDArray[np.float64], along: NDArray[np.float64], shape: tuple[int, int]) -> bool:
    """Whether the shaft meets the image's border at the smaller coordinates along the lines, not at the larger."""
    limit = np.array([shape[1] - 1, shape[0] - 1])
    to_border = np.minimum(ends, limit - ends).min(axis=2)
    position = ends @ along
    starts = np.take_along_axis(to_border, position.argmin(axis=1)[:, None], axis=1).min()
    stops = np.take_along_axis(to_border, position.argmax(axis=1)[:, None], axis=1).min()
    return bool(starts <= stops)
