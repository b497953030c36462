"""What an image says about the outline: the interface of the filter's measurements, and their form for masks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.track.outline_model import Rim

Float64 = NDArray[np.float64]

_IGNORED_MARGIN = 3  # px around ignored pixels whose edges are not the instrument's
_MARGIN = 16  # px around the mask; beyond it there is nothing but background
_OWN_VARIANCE = 0.25  # px^2, of an edge's place, where two kinds of evidence are weighed
_INSIDE = 127  # largest value outside a blurred mask
_BLUR = 1.0  # px, standard deviation; the edge of a blurred mask is found to a fraction of a pixel


@dataclass(frozen=True, eq=False)
class EdgeDistances:
    """Distances (N,), px, by which outline points lie outside the edge that was found, and whether one was, (N,).

    ``variance`` (N,), px^2, is that of the edge's place beyond the running variance of all edges.
    """

    distance: Float64
    found: NDArray[np.bool_]
    variance: Float64


@dataclass(frozen=True)
class Pass:
    """What is done after one drawing of the outline: ``steps`` of the correction, by edges within ``reach`` px."""

    reach: float
    steps: int


class OutlineEvidence(Protocol):
    """What one image says about where the outline lies: the edges of a mask, or the colours of the image."""

    def passes(self, config: TrackConfig) -> tuple[Pass, ...]:
        """Return what is done after each drawing of the outline."""
        ...

    def wider(self) -> OutlineEvidence:
        """Return the evidence for a search around the prediction, which may look for edges farther away."""
        ...

    def distances(self, pixels: Float64, rim: Rim, reach: float) -> EdgeDistances:
        """Measure how far the points of a rim, now at ``pixels`` (N, 2), lie outside the image's edge.

        The nearest edge within ``reach`` px along the rim's normals counts that has the instrument on the inner side.
        """
        ...

    def unexplained(self, pixels: Float64, rim: Rim, reach: int) -> float:
        """Return the share of what the image shows of the instrument that is farther than ``reach`` px from the rim.

        The rim's points are now at ``pixels`` (N, 2).
        """
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

    def passes(self, config: TrackConfig) -> tuple[Pass, ...]:
        """Return the same for all drawings."""
        return (Pass(config.reach_px, config.steps),) * config.draws

    def wider(self) -> OutlineEvidence:
        """Return the same evidence: where edges are is known everywhere."""
        return self

    def distances(self, pixels: Float64, rim: Rim, reach: float) -> EdgeDistances:
        """Measure how far a rim's points, now at ``pixels`` (N, 2), lie outside the mask."""
        count = int(np.ceil(reach))
        along = np.arange(-count, count + 1, dtype=np.float32)
        at, normals = (pixels - self._origin).astype(np.float32), rim.normals.astype(np.float32)
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

    def unexplained(self, pixels: Float64, rim: Rim, reach: int) -> float:
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
        index = np.rint(rim.all_pixels - self._origin).astype(np.intp)
        index = index[((index >= 0) & (index < [width, height])).all(axis=1)]
        drawn[index[:, 1], index[:, 0]] = 1
        near = cv2.dilate(drawn, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        return float(1 - cv2.countNonZero(edge & near) / total)


class BothEvidence:
    """The edges of a mask and another evidence of the same image together; where both see an edge, it is their mean."""

    def __init__(self, mask: MaskEvidence, other: OutlineEvidence) -> None:
        self._mask = mask
        self._other = other

    def passes(self, config: TrackConfig) -> tuple[Pass, ...]:
        """Return the passes of the other evidence."""
        return self._other.passes(config)

    def wider(self) -> OutlineEvidence:
        """Return both with the other evidence's wider one."""
        return BothEvidence(self._mask, self._other.wider())

    def distances(self, pixels: Float64, rim: Rim, reach: float) -> EdgeDistances:
        """Measure how far a rim's points, now at ``pixels`` (N, 2), lie outside the edges."""
        one, other = (each.distances(pixels, rim, reach) for each in (self._mask, self._other))
        shares = [each.found / (_OWN_VARIANCE + each.variance) for each in (one, other)]
        total = np.maximum(shares[0] + shares[1], 1e-12)
        mean = (shares[0] * one.distance + shares[1] * other.distance) / total
        apart = np.where(one.found & other.found, (one.distance - other.distance) ** 2 / 4, 0.0)
        variance = np.where(one.found, np.where(other.found, 0.0, one.variance), other.variance)
        return EdgeDistances(mean, one.found | other.found, variance + apart)

    def unexplained(self, pixels: Float64, rim: Rim, reach: int) -> float:
        """Return the smaller share of the two."""
        return min(each.unexplained(pixels, rim, reach) for each in (self._mask, self._other))
