"""Images and flagged pixels at reduced sizes; connected regions of a mask, their contact with the border, and holes.

An instrument enters the image from its border. In a mask it may be in several pieces, because glare or shadow across it
separates the wrist from the shaft.
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Bool, Float32, Image
from dvrk_cmaes.segment.prompts import Prompts

REDUCED: Final = 320
"""px, longer side of the reduced images in which instruments are looked for."""
FINEST: Final = 1000
"""px, longer side above which masks and backgrounds are found in a reduced image."""
SMALLEST: Final = 8
"""px, least shorter side of an image in which a mask is looked for."""
_INSIDE_SHARE = 0.2  # weight of the area of a region that does not meet the border, against 1 for one that does
_LEAST_BORDER = 5  # least number of pixels on the border for a region to meet it
_LEAST_SHARE = 0.004  # least area of a further piece, as a fraction of the chosen region's
_LARGEST_HOLE = 0.01  # largest area of a hole that is filled, as a fraction of the image


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
    return np.asarray(cv2.resize(flags.view(np.uint8) * np.uint8(254), size, interpolation=how) > 127)


def meets_border(mask: Bool, outside: Bool) -> bool:
    """Whether a mask (H, W) meets the image's border or the pixels ``outside`` (H, W) the field of view."""
    return int(_border(outside)[mask].sum()) >= _LEAST_BORDER


def sides_met(mask: Bool) -> int:
    """Return the number of the image's sides that a mask (H, W) meets with at least 5 pixels."""
    return sum(int(side.sum()) >= _LEAST_BORDER for side in _sides(mask))


def _sides(image: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Return the left, top, right and bottom side of an image (H, W)."""
    return image[:, 0], image[0], image[:, -1], image[-1]


def _border(outside: Bool) -> NDArray[np.uint8]:
    """Count the sides of the image that each pixel (H, W) is on, and the edge of the field of view next to it."""
    border = np.asarray(cv2.dilate(outside.astype(np.uint8), np.ones((3, 3), np.uint8)), np.uint8)
    for side in _sides(border):
        side += 1
    return border


def instrument_region(mask: Bool, gap: float, prompts: Prompts) -> Bool:
    """Keep the region that is most likely the instrument, and the pieces near it.

    The region with the largest area is chosen, where the area of regions that do not meet the border has less weight.
    Then all regions within ``gap`` of the chosen ones are added until there are no more.

    Parameters
    ----------
    mask
        (H, W).
    gap
        Largest distance of a piece from the regions chosen before, px.
    prompts
        The regions that contain its points are chosen instead, if there are any.

    Returns
    -------
    (H, W) bool
        Empty if the mask is.
    """
    count, labels, measures = _regions(mask, connectivity=8)
    if count < 2:
        return np.zeros_like(mask)
    marked = {int(labels[round(v), round(u)]) for u, v in prompts.points} - {0}
    areas = measures[:, cv2.CC_STAT_AREA].astype(np.float64)
    areas[0] = 0
    at_border = np.bincount(labels.ravel(), _border(prompts.outside).ravel()) >= _LEAST_BORDER
    chosen = marked or {int((areas * np.where(at_border, 1.0, _INSIDE_SHARE)).argmax())}
    first = np.isin(np.arange(count), list(chosen))
    pieces = (first | (areas >= _LEAST_SHARE * areas[first].max()) & (areas > 0))[labels]
    _, joined = cv2.connectedComponents((distance_to(pieces) <= gap / 2).astype(np.uint8), connectivity=8)
    return np.asarray(pieces & np.isin(joined, joined[first[labels]]))


def fill_holes(mask: Bool) -> Bool:
    """Fill the small holes of a mask (H, W): regions of background that do not meet the image's border."""
    _, labels, measures = _regions(~mask, connectivity=4)
    height, width = mask.shape
    left, top = measures[:, cv2.CC_STAT_LEFT], measures[:, cv2.CC_STAT_TOP]
    right, bottom = left + measures[:, cv2.CC_STAT_WIDTH], top + measures[:, cv2.CC_STAT_HEIGHT]
    inside = (left > 0) & (top > 0) & (right < width) & (bottom < height)
    hole = inside & (measures[:, cv2.CC_STAT_AREA] <= _LARGEST_HOLE * mask.size)
    hole[0] = False  # the mask itself
    return np.asarray(mask | hole[labels]) if hole.any() else mask


def distance_to(mask: Bool) -> Float32:
    """Return the distance of each pixel from a mask (H, W), px; 0 on the mask, large everywhere if it is empty."""
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def _regions(mask: Bool, connectivity: int) -> tuple[int, NDArray[np.int32], NDArray[np.int32]]:
    """Label the regions of a mask; returns the number of labels with the background's 0, labels (H, W), statistics."""
    count, labels, measures, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=connectivity)
    return count, np.asarray(labels, np.int32), np.asarray(measures, np.int32)
