"""What hides an instrument: tissue that lies before it, and the edge of the endoscope's round picture."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.synth.masks import lump_of_tissue
from dvrk_cmaes.synth.truth import Truth


def tissue_before_a_jaw(
    camera: Camera,
    truth: Truth,
    rng: np.random.Generator,
    *,
    radius: float = 62.0,
    hidden: float = 0.0035,
    jaw: int = 0,
) -> NDArray[np.bool_]:
    """Lay a lump of tissue, of a radius in px, before the end of a jaw and hide some length of it, m: (H, W)."""
    tip, other = camera.project(truth.tips)[[jaw, 1 - jaw]]
    hinge = camera.project(truth.wrist)[1]
    away = (tip - hinge) / np.linalg.norm(tip - hinge) + (tip - other) / np.linalg.norm(tip - other)
    away /= np.linalg.norm(away)
    inside = hidden * camera.fx / truth.tips[jaw, 2]
    return lump_of_tissue((camera.height, camera.width), rng, tip + (radius - inside) * away, radius)


def with_brim(region: NDArray[np.bool_], width: int = 4) -> NDArray[np.bool_]:
    """Widen a region (H, W) by some px on every side: what a person would mark to be ignored."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * width + 1, 2 * width + 1))
    return np.asarray(cv2.dilate(region.astype(np.uint8), disc) > 0)


def beyond_lens_edge(camera: Camera, share: float) -> NDArray[np.bool_]:
    """Pixels (H, W) beyond an endoscope's round picture, whose radius is a share of half the image's diagonal."""
    v, u = np.mgrid[: camera.height, : camera.width]
    away = np.hypot(u - (camera.width - 1) / 2, v - (camera.height - 1) / 2)
    return np.asarray(away > share * np.hypot(camera.width, camera.height) / 2)
