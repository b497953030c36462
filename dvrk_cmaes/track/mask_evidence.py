"""The edges of a mask as evidence about the outline."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.silhouette.sliced_call import worked
from dvrk_cmaes.track.drawn_outline import DrawnOutline
from dvrk_cmaes.track.edges import EdgeDistances, Pass

Float64 = NDArray[np.float64]

_IGNORED_MARGIN = 3  # px around ignored pixels whose edges are not the instrument's
_MARGIN = 16  # px around the mask; beyond it there is nothing but background
_INSIDE = 127  # largest value outside a blurred mask
_WORK = 200  # pixel rows of silhouettes that take as long as the correction by the distances of an outline
_BLUR = 1.0  # px, standard deviation; the edge of a blurred mask is found to a fraction of a pixel


class MaskEvidence:
    """The edges of a mask as evidence about the outline in one view; ``mask`` and ``ignore`` are (H, W) bool."""

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

    def passes(self, config: TrackConfig) -> tuple[Pass, ...]:
        """Return the same for all drawings."""
        return (Pass(config.reach_px, config.steps),) * config.draws

    def wider(self) -> MaskEvidence:
        """Return the same evidence: where edges are is known everywhere."""
        return self

    def distances(self, pixels: Float64, outline: DrawnOutline, reach: float) -> EdgeDistances:
        """Measure how far an outline's points, now at ``pixels`` (N, 2), lie outside the mask."""
        worked(_WORK, drawn=False)
        count = int(np.ceil(reach))
        along = np.arange(-count, count + 1, dtype=np.float32)
        at, normals = (pixels - self._origin).astype(np.float32), outline.normals.astype(np.float32)
        u, v = (at[:, k, None] + normals[:, k, None] * along for k in (0, 1))
        profile = cv2.remap(self._blurred, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        inside = profile > _INSIDE
        edge = inside[:, :-1] > inside[:, 1:]
        nearest = np.where(edge, np.abs(along[:-1] + 0.5), np.inf).argmin(axis=1)
        rows = np.arange(len(pixels))
        inner, outer = (profile[rows, nearest + k].astype(np.float64) for k in (0, 1))
        place = along[nearest] + (inner - _INSIDE - 0.5) / np.maximum(inner - outer, 1.0)
        found = edge[rows, nearest] & (np.abs(place) <= reach)
        if self._valid is not None:
            pixel = np.clip(np.rint(at), 0, np.array(self._valid.shape[::-1]) - 1).astype(np.intp)
            found &= self._valid[pixel[:, 1], pixel[:, 0]] > 0
        return EdgeDistances(np.where(found, -place, 0.0), found, np.zeros(len(pixels)))

    def unexplained(self, pixels: Float64, outline: DrawnOutline, reach: int) -> float:
        """Return the share of the mask's edge that is farther than ``reach`` px from the outline as it was drawn."""
        inner = cv2.erode(self._mask, np.ones((3, 3), np.uint8))  # the image's border does not erode
        edge = (self._mask != inner).astype(np.uint8)
        if self._valid is not None:
            edge &= self._valid
        total = cv2.countNonZero(edge)
        if not total:
            return 1.0
        height, width = edge.shape
        drawn = np.zeros_like(edge)
        (all_pixels,) = outline.all_pixels.values()
        index = np.rint(all_pixels - self._origin).astype(np.intp)
        index = index[((index >= 0) & (index < [width, height])).all(axis=1)]
        drawn[index[:, 1], index[:, 0]] = 1
        near = cv2.dilate(drawn, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        return float(1 - cv2.countNonZero(edge & near) / total)
