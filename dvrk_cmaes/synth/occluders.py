"""Regions that occlude an instrument: tissue in front of it, and the outside of the circular field of view."""

from __future__ import annotations

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.synth.masks import tissue_region
from dvrk_cmaes.synth.truth import Truth


def tissue_over_jaw(
    camera: Camera,
    truth: Truth,
    rng: np.random.Generator,
    *,
    radius: float = 62.0,
    hidden: float = 0.0035,
    jaw: int = 0,
) -> Bool:
    """Draw a region of tissue (H, W) in front of the end of a jaw.

    Parameters
    ----------
    camera, truth
        The camera, and the instrument's true pose and joints.
    rng
        Random numbers for the region's outline.
    radius
        Radius of the region, px.
    hidden
        Length of the jaw that is covered, m.
    jaw
        Index of the jaw, 0 or 1.
    """
    tip, other = camera.project(truth.tips)[[jaw, 1 - jaw]]
    hinge = camera.project(truth.wrist)[1]
    away = (tip - hinge) / np.linalg.norm(tip - hinge) + (tip - other) / np.linalg.norm(tip - other)
    away /= np.linalg.norm(away)
    inside = hidden * camera.fx / truth.tips[jaw, 2]
    return tissue_region((camera.height, camera.width), rng, tip + (radius - inside) * away, radius)


def dilate_region(region: Bool, width: int = 4) -> Bool:
    """Dilate a region (H, W) by ``width`` px, as a region marked by hand would be larger than what it covers."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * width + 1, 2 * width + 1))
    return np.asarray(cv2.dilate(region.astype(np.uint8), disc) > 0)


def outside_lens_circle(camera: Camera, share: float) -> Bool:
    """Return the pixels (H, W) outside a central circle whose radius is ``share`` times half the image's diagonal."""
    v, u = np.mgrid[: camera.height, : camera.width]
    away = np.hypot(u - (camera.width - 1) / 2, v - (camera.height - 1) / 2)
    return np.asarray(away > share * np.hypot(camera.width, camera.height) / 2)
