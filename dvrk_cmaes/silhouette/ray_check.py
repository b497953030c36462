"""A second opinion on a silhouette: Embree traces the pixels beside its outline.

Spans and rays decide coverage in two ways that share no code but the meshes. Where they should ever disagree it is
beside the outline, so tracing that band, a few thousand rays, confirms a whole silhouette.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.silhouette.renderer import Renderer


def confirmed(
    renderer: Renderer,
    camera_from_root: NDArray[np.float64],
    joints: NDArray[np.float64],
    masks: NDArray[np.bool_],
) -> tuple[NDArray[np.bool_], int]:
    """Silhouettes (C, H, W) of C poses with the pixels beside their outlines traced, and how many rays that took."""
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
