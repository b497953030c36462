"""What an image says about the outline: the interface of the filter's measurements, and their form for masks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

_IGNORED_MARGIN = 3  # px around ignored pixels whose edges are not the instrument's
_MARGIN = 16  # px around the mask; beyond it there is nothing but background
_BLUR = 1.0  # px, standard deviation; the edge of a blurred mask is found to a fraction of a pixel


@dataclass(frozen=True, eq=False)
class EdgeDistances:
    """Distances (N,), px, by which outline points lie outside the edge that was found, and whether one was, (N,)."""

    distance: Float64
    found: NDArray[np.bool_]


class OutlineEvidence(Protocol):
    """What one image says about where the outline lies. Masks are one kind; colours of the image can be another."""

    def distances(self, pixels: Float64, normals: Float64, reach: float) -> EdgeDistances:
        """Measure how far outline points (N, 2) lie outside the image's edge, along unit normals (N, 2).

        The nearest edge within ``reach`` px counts that has the instrument on the inner side.
        """
        ...

    def unexplained(self, pixels: Float64, reach: int) -> float:
        """Return the share of the image's edges that are farther than ``reach`` px from outline points (M, 2)."""
        ...


class MaskEvidence:
    """The edges of a mask as evidence about the outline; ``mask`` and ``ignore`` are (H, W) bool."""

    def __init__(self, mask: NDArray[np.bool_], ignore: NDArray[np.bool_] | None = None) -> None:
        grey = mask.astype(np.uint8)
        if ignore is not None:
            grey[ignore] = 0
        left, top, width, height = cv2.boundingRect(grey)
        low = np.maximum(np.array([left, top]) - _MARGIN, 0)
        high = np.minimum(np.array([left + width, top + height]) + _MARGIN, mask.shape[::-1])
        window = np.s_[low[1] : high[1], low[0] : high[0]]
        self._origin = low.astype(np.float64)
        self._mask = np.ascontiguousarray(grey[window])
        self._valid: NDArray[np.uint8] | None = None
        if ignore is not None:
            kernel = np.ones((2 * _IGNORED_MARGIN + 1,) * 2, np.uint8)
            dilated = cv2.dilate(ignore.astype(np.uint8), kernel)
            self._valid = np.asarray(dilated[window] == 0, np.uint8)
        self._blurred = cv2.GaussianBlur(self._mask * np.uint8(255), (0, 0), _BLUR, borderType=cv2.BORDER_REPLICATE)

    def distances(self, pixels: Float64, normals: Float64, reach: float) -> EdgeDistances:
        """Measure how far outline points (N, 2) lie outside the mask."""
        count = int(np.ceil(reach))
        along = np.arange(-count, count + 1, dtype=np.float32)
        at = (pixels - self._origin).astype(np.float32)
        u, v = (at[:, k : k + 1] + normals[:, k : k + 1].astype(np.float32) * along for k in (0, 1))
        profile = cv2.remap(self._blurred, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
        inside = profile >= 127.5
        edge = inside[:, :-1] & ~inside[:, 1:]
        place = along[:-1] + (profile[:, :-1] - 127.5) / np.maximum(profile[:, :-1] - profile[:, 1:], 1e-3)
        away = np.where(edge, np.abs(place), np.inf)
        nearest = away.argmin(axis=1)
        rows = np.arange(len(pixels))
        found = away[rows, nearest] <= reach
        if self._valid is not None:
            inner = np.clip(np.rint(at), 0, np.array(self._valid.shape[::-1]) - 1).astype(np.intp)
            found &= self._valid[inner[:, 1], inner[:, 0]] > 0
        return EdgeDistances(np.where(found, -place[rows, nearest], 0.0).astype(np.float64), found)

    def unexplained(self, pixels: Float64, reach: int) -> float:
        """Return the share of the mask's edge that is farther than ``reach`` px from outline points (M, 2)."""
        inner = cv2.erode(self._mask, np.ones((3, 3), np.uint8))  # the image's border does not erode
        edge = (self._mask != inner).astype(np.uint8)
        if self._valid is not None:
            edge &= self._valid
        total = cv2.countNonZero(edge)
        if not total:
            return 1.0
        height, width = edge.shape
        drawn = np.zeros_like(edge)
        index = np.rint(pixels - self._origin).astype(np.intp)
        index = index[((index >= 0) & (index < [width, height])).all(axis=1)]
        drawn[index[:, 1], index[:, 0]] = 1
        near = cv2.dilate(drawn, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        return float(1 - cv2.countNonZero(edge & near) / total)
