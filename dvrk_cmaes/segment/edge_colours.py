"""Where along an outline the image is halfway between inside and outside.

A lens and a sensor blur every edge; the instrument ends where a pixel's colour is half its own and half the
background's. Counted colours do not know this: a mixed colour may happen to be frequent on one side. Here each pixel is
compared with the mean colours just inside and just outside, nearby.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.outline_noise import signed_distance

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]

_BAND = (2.5, 14.0)  # px from the outline, where the means are taken
_NEARBY = 8.0  # px, spread of the means' weights
_SMOOTH = 1.0  # px
_BRIGHTNESS = 0.5  # weight of brightness beside colour: shadows have the background's colour, and lie beside the tool
_TEXTURE = 6.0  # grey levels: differences between the means that count little
_STEEPNESS = 8.0  # log-odds between all background and all instrument


def halfway_odds(image: NDArray[np.uint8], mask: Bool) -> Float32:
    """Log-odds of instrument (H, W) by the mean colours inside and outside of a mask (H, W), 0 far from its outline."""
    away = signed_distance(mask)
    colours = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _SMOOTH)
    blue, green, red = (colours[..., k] for k in range(3))
    # differences of channels, and brightness: linear, so that a mixture lies on the line between what is mixed
    parts = np.stack([blue - red, green - red, green - blue, _BRIGHTNESS * (blue + green + red)], axis=-1) / np.sqrt(3)
    inside, outside = (_local_mean(parts, (side > _BAND[0]) & (side < _BAND[1])) for side in (-away, away))
    between = inside - outside
    square = (between**2).sum(axis=-1)
    share = ((parts - outside) * between).sum(axis=-1) / np.maximum(square, 1e-3)
    sure = square / (square + _TEXTURE**2)
    odds = _STEEPNESS * sure * np.clip(share - 0.5, -0.5, 0.5)
    return np.asarray(np.where(np.abs(away) < _BAND[1], odds, 0), np.float32)


def _local_mean(parts: Float32, where: Bool) -> Float32:
    """Mean of an image (H, W, C) over the pixels of a region near each pixel; 0 where there are none."""
    weight = cv2.GaussianBlur(where.astype(np.float32), (0, 0), _NEARBY)
    total = cv2.GaussianBlur(parts * where[..., None], (0, 0), _NEARBY)
    return np.asarray(total / np.maximum(weight, 1e-6)[..., None], np.float32)
