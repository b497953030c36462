"""Colours of what moves before the rest of a recording's images, as the instrument does before tissue.

The background of a pixel is the median of all images. Tissue moves a little with breathing and pulse: a pixel of an
image belongs to it whose colour lies within those of the background nearby. Only ratios of channels are compared, which
shadows leave as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.geometry import Bool, Image
from dvrk_cmaes.segment.background import FEWEST
from dvrk_cmaes.segment.colours import measure_colours
from dvrk_cmaes.segment.sizes import REDUCED, shrunk

MOST: Final = 30
"""Images that are compared, at most."""

_NEARBY: Final = 0.02  # of the longer side, by which tissue may move
_TOLERANCE: Final = 0.08  # by which logarithms of ratios may lie outside those nearby
_OPENED: Final = 5  # px, narrower pieces do not count
_SHARE: Final = (0.005, 0.5)  # of all pixels, that may move


def moving_pixels(images: Sequence[Image]) -> list[tuple[Image, Bool]] | None:
    """Find what moves in images (H, W, 3) uint8 BGR of one size, spread over a recording.

    Returns the images at a reduced size, and the pixels (h, w) of each whose colours are not those of the background
    nearby; None if the images are too few, of several sizes, or show nothing that moves before something that does not.
    """
    if len(images) < FEWEST or len({image.shape for image in images}) > 1:
        return None
    small = [reduced(image) for image in images]
    ratios = np.stack([measure_colours(image).features[..., :2] for image in small])
    middle = np.asarray(np.median(ratios, axis=0), np.float32)
    size = 2 * max(round(_NEARBY * max(middle.shape)), 1) + 1
    kernel = np.ones((size, size), np.uint8)
    low, high = cv2.erode(middle, kernel) - _TOLERANCE, cv2.dilate(middle, kernel) + _TOLERANCE
    opening = np.ones((_OPENED, _OPENED), np.uint8)
    moving = []
    for own in ratios:
        outside = ((own < low) | (own > high)).any(axis=2).astype(np.uint8)
        moving.append(np.asarray(cv2.morphologyEx(outside, cv2.MORPH_OPEN, opening) > 0))
    share = float(np.mean(moving))
    return list(zip(small, moving, strict=True)) if _SHARE[0] < share < _SHARE[1] else None


def reduced(image: Image) -> Image:
    """Return an image at the size at which images are compared."""
    return shrunk(image, REDUCED)
