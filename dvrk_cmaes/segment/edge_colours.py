"""Log-odds of instrument by where a blurred edge crosses the midpoint between the colours of its two sides.

Lens and sensor blur every edge, so that the colour of a pixel on the edge is a mixture of the colours on its two sides;
the edge is where the mixture has equal parts. Colour histograms cannot locate it, since mixed colours may be frequent
on one of the sides. Here each pixel's share of the instrument's colour is computed from the local mean colours inside
and outside the outline.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Bool, Float32

_BAND = (2.5, 14.0)  # px, distances from the outline between which the means are taken
_NEARBY = 8.0  # px, standard deviation of the Gaussian weights of the means
_COARSER = 4  # by which the image is reduced for the means
_SMOOTH = 1.0  # px, standard deviation of the Gaussian that smooths the image
_BRIGHTNESS = 0.5  # weight of brightness against colour; below 1, because the tool casts shadows along its outline
_TEXTURE = 6.0  # grey levels, difference of the two means at which the log-odds have half their weight
_STEEPNESS = 8.0  # difference of the log-odds between the background's and the instrument's mean colour


def edge_log_odds(image: NDArray[np.uint8], away: Float32) -> Float32:
    """Return log-odds of instrument (H, W) by the local mean colours on both sides of a mask's outline.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    away
        (H, W), the signed distance from the outline, px, negative inside.

    Returns
    -------
    (H, W) float32
        Positive where a pixel's colour is nearer to the mean inside than to the mean outside; 0 far from the outline.
    """
    colours = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _SMOOTH)
    blue, green, red = (colours[..., k] for k in range(3))
    # differences of channels, and brightness: linear, so that a mixture of two colours lies on the line between them
    parts = np.stack([blue - red, green - red, green - blue, _BRIGHTNESS * (blue + green + red)], axis=-1) / np.sqrt(3)
    inside, outside = (_local_mean(parts, (side > _BAND[0]) & (side < _BAND[1])) for side in (-away, away))
    between = inside - outside
    square = np.einsum("ijk,ijk->ij", between, between)
    share = np.einsum("ijk,ijk->ij", parts - outside, between) / np.maximum(square, 1e-3)
    weight = square / (square + _TEXTURE**2)
    odds = _STEEPNESS * weight * np.clip(share - 0.5, -0.5, 0.5)
    return np.asarray(np.where(np.abs(away) < _BAND[1], odds, 0), np.float32)


def _local_mean(parts: Float32, where: Bool) -> Float32:
    """Return the Gaussian-weighted local mean (H, W, C) of an image (H, W, C) over a region (H, W); 0 far from it.

    It is smooth, and computed at a reduced size.
    """
    height, width = where.shape
    size = max(width // _COARSER, 1), max(height // _COARSER, 1)

    def smoothed(values: Float32) -> Float32:
        small = cv2.GaussianBlur(cv2.resize(values, size, interpolation=cv2.INTER_AREA), (0, 0), _NEARBY / _COARSER)
        return np.asarray(cv2.resize(small, (width, height)), np.float32)

    weight = where.astype(np.float32)
    return np.asarray(smoothed(parts * weight[..., None]) / np.maximum(smoothed(weight), 1e-6)[..., None], np.float32)
