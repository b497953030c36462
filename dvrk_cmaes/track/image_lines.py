"""Pixels of an image along lines across an outline."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


def pixels_along(
    image: NDArray[np.uint8], at: Float64, normals: Float64, along: Float32, seen: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the nearest pixels of an image (H, W, 3) on N lines, (N, K, 3), and whether they are in it, (N, K).

    ``at`` (N, 2) are points of the lines, ``normals`` (N, 2) their directions, ``along`` (K,) px the distances from
    those points. Pixels that are not ``seen`` (H, W) count as not in the image.
    """
    height, width = image.shape[:2]
    begin, direction = (at + 0.5).astype(np.float32), normals.astype(np.float32)
    u, v = (np.floor(begin[:, k, None] + direction[:, k, None] * along).astype(np.int32) for k in (0, 1))
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    index = v * width + u
    index[~inside] = 0
    if seen is not None:
        inside &= seen.ravel().take(index)
    return image.reshape(-1, 3).take(index, axis=0), inside
