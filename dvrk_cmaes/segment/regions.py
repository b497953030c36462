"""Regions of a mask: which of them are the instrument, and what a single one looks like.

An instrument comes in from the image's border and is one piece, but for bands of glare or shadow across it that part
its wrist from its shaft.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.segment.prompts import Prompts

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]

_INSIDE_SHARE = 0.2  # a region that does not meet the border counts for so much of its area
_LEAST_BORDER = 5  # pixels on the border that make a region meet it
_LEAST_SHARE = 0.004  # of the largest region's area, for a piece to belong to it
_LARGEST_HOLE = 0.01  # of the image


@dataclass(frozen=True)
class Border:
    """Where a mask meets the image's border: pixels on the left, top, right and bottom."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def pixels(self) -> int:
        """Pixels on all sides."""
        return self.left + self.top + self.right + self.bottom

    @property
    def sides(self) -> int:
        """Sides that the mask meets by more than a few pixels."""
        return sum(count >= _LEAST_BORDER for count in (self.left, self.top, self.right, self.bottom))


def meets_border(mask: Bool, outside: Bool | None = None) -> bool:
    """Whether a mask (H, W) comes in from the image's border, or from ``outside`` (H, W) what the camera sees."""
    pixels = border_of(mask).pixels
    if outside is not None:
        pixels += int((cv2.dilate(outside.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_) & mask).sum())
    return pixels >= _LEAST_BORDER


def border_of(mask: Bool) -> Border:
    """Measure where a mask (H, W) meets the image's border."""
    sides = mask[:, 0], mask[0], mask[:, -1], mask[-1]
    return Border(*(int(side.sum()) for side in sides))


def instrument_region(mask: Bool, gap: float, prompts: Prompts) -> Bool:
    """Keep the region that is most likely the instrument, and its pieces.

    Parameters
    ----------
    mask
        (H, W).
    gap
        How far a piece may be from the rest, px.
    prompts
        Only regions with one of its points can be the instrument, where there are such regions.

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
    chosen = marked or {max(range(1, count), key=lambda i: areas[i] * _likely(labels == i, prompts))}
    least = _LEAST_SHARE * max(areas[i] for i in chosen)
    pieces = [i for i in range(1, count) if i not in chosen and areas[i] >= least]
    while pieces:
        far = cv2.distanceTransform(np.isin(labels, list(chosen), invert=True).astype(np.uint8), cv2.DIST_L2, 5)
        near = {i for i in pieces if far[_window(measures[i])][labels[_window(measures[i])] == i].min() <= gap}
        if not near:
            break
        chosen |= near
        pieces = [i for i in pieces if i not in near]
    return np.isin(labels, list(chosen))


def without_holes(mask: Bool) -> Bool:
    """Fill a mask's holes, (H, W), but for large ones; what the border closes off is no hole."""
    count, labels, measures = _regions(~mask, connectivity=4)
    height, width = mask.shape
    left, top = measures[:, cv2.CC_STAT_LEFT], measures[:, cv2.CC_STAT_TOP]
    right, bottom = left + measures[:, cv2.CC_STAT_WIDTH], top + measures[:, cv2.CC_STAT_HEIGHT]
    inside = (left > 0) & (top > 0) & (right < width) & (bottom < height)
    hole = inside & (measures[:, cv2.CC_STAT_AREA] <= _LARGEST_HOLE * mask.size)
    hole[0] = False  # the mask itself
    return np.asarray(mask | (hole[labels] if count > 1 else False))


def distance_to(mask: Bool) -> Float32:
    """Distance of each pixel to a mask, (H, W), px; 0 on it, and everywhere far where it is empty."""
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def _regions(mask: Bool, connectivity: int) -> tuple[int, NDArray[np.int32], NDArray[np.int32]]:
    """Label a mask's regions: how many labels, the background's 0 among them, the labels (H, W), and their measures."""
    count, labels, measures, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=connectivity)
    return count, np.asarray(labels, np.int32), np.asarray(measures, np.int32)


def _likely(region: Bool, prompts: Prompts) -> float:
    """Weigh a region's area by whether it comes in from the border."""
    return 1.0 if meets_border(region, prompts.outside) else _INSIDE_SHARE


def _window(measures: NDArray[np.int32]) -> tuple[slice, slice]:
    """Rows and columns of a region."""
    left, top, width, height = (int(value) for value in measures[:4])
    return slice(top, top + height), slice(left, left + width)
