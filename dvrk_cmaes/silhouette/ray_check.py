"""Check of silhouettes by ray tracing in a band along their outlines.

Coverage from spans and coverage from rays are computed independently of each other, from the same meshes. They can
differ only next to the outline, so it is enough to trace that band, a few thousand rays per silhouette.
"""

from __future__ import annotations

import cv2
import numpy as np

from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.silhouette.renderer import Renderer


def trace_near_outlines(
    renderer: Renderer, camera_from_root: Float64, joints: Float64, masks: Bool
) -> tuple[Bool, int]:
    """Retrace the pixels on both sides of the outlines of C masks, (C, H, W).

    Returns the masks with the traced values and the number of rays.
    """
    result = masks.copy()
    links = renderer.body.camera_from_links(camera_from_root, joints)
    rays = 0
    for i, mask in enumerate(masks):
        band = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
        row, column = np.nonzero(band)
        pixels = np.stack([column, row], axis=1).astype(np.float64)
        directions = np.c_[renderer.camera.normalise(pixels), np.ones(len(pixels))]
        one = np.zeros(len(pixels), dtype=np.intp)
        result[i, row, column] = renderer.body.scenes.covered(links[i : i + 1], one, directions)
        rays += len(pixels)
    return result, rays
