"""Log-odds of instrument by the straight sides of the shaft, fitted to a rough mask.

In the dark corners of an endoscope's image, cloth and tissue are as grey as the shaft, and a mask found by colours
leaks into them. The sides of the shaft are straight up to the image's border, which limits the mask there.
"""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.shaft_edges import find_contour, find_shaft_edges
from dvrk_cmaes.geometry import Bool, Float32

_FOCAL = 1.2  # assumed focal length, in longer sides of the image; its exact value matters little to find the sides
_RADIUS = 0.004  # m, assumed radius of the shaft, likewise
_SLACK = 1.5  # px on either side of a line, in which the log-odds are 0
_STEEPNESS = 1.0  # log-odds per px beyond that
_LARGEST = 4.0  # bound of the log-odds


def shaft_log_odds(part: Bool, shape: tuple[int, ...], window: tuple[slice, slice]) -> Float32 | None:
    """Return log-odds of instrument (h, w) by the shaft's sides in a mask, or None if no sides are found.

    ``part`` (h, w) is the mask in a window (rows, columns) of an image of a shape (H, W). The log-odds are 0 distally
    of the more proximal of the two sides' distal ends, where the wrist begins.
    """
    mask = np.zeros(shape, np.bool_)
    mask[window] = part
    height, width = mask.shape
    focal = _FOCAL * max(height, width)
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    pairs = find_shaft_edges(mask, find_contour(mask, camera), camera, _RADIUS)
    if isinstance(pairs, str):
        return None
    lines = pairs[0].planes @ np.linalg.inv(camera.matrix)
    lines /= np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    v, u = np.mgrid[window].astype(np.float32)
    first, second = (line[0] * u + line[1] * v + line[2] for line in lines)  # px, positive outside
    outside = np.maximum(first, second)
    pull = -_STEEPNESS * np.sign(outside) * np.maximum(np.abs(outside) - _SLACK, 0)
    ends = pairs[0].ends  # (2, 2, 2), px, of each side
    across = lines[0, :2] - lines[1, :2]  # of opposite normals
    along = np.array([-across[1], across[0]]) / np.linalg.norm(across)
    to_border = np.minimum(ends, [width - 1, height - 1] - ends).min(axis=2)
    starts, stops = np.take_along_axis(to_border, (ends @ along).argsort(axis=1), axis=1).min(axis=0)
    along = along if starts <= stops else -along  # from the border of the image
    on_shaft = along[0] * u + along[1] * v < (ends @ along).max(axis=1).min()
    return np.asarray(np.where(on_shaft, np.clip(pull, -_LARGEST, _LARGEST), 0), np.float32)
