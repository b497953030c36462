"""How far off a mask's outline is, and over what length its errors hang together, seen against a fitted silhouette.

A segmenter's outline wavers over many pixels, so a thousand contour points are far fewer measurements. Both the spread
of the outline's error and its correlation length are read from the residuals along the contour; they set what the
outline is worth against the readings, and the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.distance_field import distance_within
from dvrk_cmaes.evidence.shaft_edges import Contour

Float64 = NDArray[np.float64]

_LEAST_SIGMA = 0.25  # px: what the pixel grid alone does to an exact mask
_LENGTHS = (2.0, 40.0)  # px
_SAMPLED_TOGETHER = 512  # OpenCV limits each side of what it samples at once
_CLIP = 3.0  # standard deviations; beyond lies a segmenter's mistake


@dataclass(frozen=True)
class OutlineNoise:
    """Standard deviation of the outline's error, px, and the length of contour that makes one measurement, px."""

    sigma: float
    length: float

    @property
    def inflation(self) -> float:
        """By how much a covariance that takes the errors for small and Gaussian must grow to hold the truth.

        A rough outline's errors are neither. Fitted to 240 made frames of all levels, where the 90 % intervals then
        hold the truth in 85 to 100 % of each level's frames.
        """
        return 1.0 + (self.sigma / 1.2) ** 2


def signed_distance(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance in px to a mask's outline, negative inside, (H, W); the mask must be neither empty nor full."""
    return np.where(mask, 0.5 - distance_within(mask), distance_within(~mask) - 0.5).astype(np.float32)


def sampled(image: NDArray[np.float32], at: Float64) -> Float64:
    """Values of an image (H, W) at pixels (N, 2), bilinear, (N,)."""
    rows = -(-len(at) // _SAMPLED_TOGETHER)
    if rows == 0:
        return np.zeros(0)
    spots = np.zeros((rows * _SAMPLED_TOGETHER, 2), dtype=np.float32)
    spots[: len(at)] = at
    u, v = spots.reshape(rows, _SAMPLED_TOGETHER, 2).transpose(2, 0, 1)
    values = cv2.remap(
        image, np.ascontiguousarray(u), np.ascontiguousarray(v), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(values.ravel()[: len(at)], dtype=np.float64)


def measure_noise(contour: Contour, silhouette: NDArray[np.bool_]) -> OutlineNoise:
    """Measure the noise of a mask's contour against the silhouette (H, W) fitted to it."""
    if len(contour.pixels) < 40 or silhouette.all() or not silhouette.any():
        return OutlineNoise(sigma=2.0, length=_LENGTHS[1])
    error = sampled(signed_distance(silhouette), contour.pixels)
    sigma = max(1.4826 * float(np.median(np.abs(error))), _LEAST_SIGMA)
    error = np.clip(error, -_CLIP * sigma, _CLIP * sigma)
    spread = max(float(np.sqrt(np.mean(error**2))), _LEAST_SIGMA)
    spacing = float(np.median(np.linalg.norm(np.diff(contour.pixels, axis=0), axis=1)))
    most = min(int(_LENGTHS[1]), len(error) // 4)
    variance = float(np.mean(error**2)) + 1e-12
    length = spacing
    for lag in range(1, most):
        correlation = float(np.mean(error[lag:] * error[:-lag])) / variance
        if correlation < 0.1:
            break
        length += 2 * correlation * spacing
    return OutlineNoise(spread, float(np.clip(length, *_LENGTHS)))
