"""Images and flagged pixels at reduced sizes."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.geometry import Bool, Image

REDUCED: Final = 320
"""px, longer side of the reduced images in which instruments are looked for."""
FINEST: Final = 1000
"""px, longer side above which masks and backgrounds are found in a reduced image."""
SMALLEST: Final = 8
"""px, least shorter side of an image in which a mask is looked for."""


def size_within(shape: tuple[int, ...], longest: int) -> tuple[tuple[int, int], float]:
    """Return width and height, px, and scale of an image of a shape (H, W, ...) with at most some px as longer side."""
    scale = min(longest / max(shape[:2]), 1.0)
    return (max(round(shape[1] * scale), 1), max(round(shape[0] * scale), 1)), scale


def shrunk(image: Image, longest: int) -> Image:
    """Return an image (H, W) or (H, W, C) with at most some pixels as longer side."""
    size, scale = size_within(image.shape, longest)
    return image if scale == 1 else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def resized(flags: Bool, size: tuple[int, int]) -> Bool:
    """Return pixels (H, W) at another size, width and height in px: those more than half of which is flagged."""
    if size == flags.shape[1::-1]:
        return flags
    how = cv2.INTER_AREA if size[0] < flags.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(flags.astype(np.float32), size, interpolation=how) > 0.5)
