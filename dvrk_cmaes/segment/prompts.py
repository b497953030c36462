"""Prompts as regions of an image: pixels known to be instrument and pixels known to be background."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.segment.segmentation import Box, Pixel

_RADIUS = 4.0  # px of the full image, radius of the disc about a point


@dataclass(frozen=True, eq=False)
class Prompts:
    """Prompts in pixels of the image at one size.

    background, tool : (H, W) bool, pixels known to be background or instrument; None if there are none.
    points : pixels (u, v) on the instrument. box : left, top, right, bottom of a box around it.
    outside : (H, W) bool, pixels outside the field of view, also part of ``background``; None if there are none.
    """

    background: Bool | None = None
    tool: Bool | None = None
    points: tuple[Pixel, ...] = ()
    box: Box | None = None
    outside: Bool | None = None

    @property
    def given(self) -> bool:
        """Whether there is a box or a point on the instrument."""
        return self.box is not None or bool(self.points)

    @property
    def around_box(self) -> Bool | None:
        """Background pixels (H, W) within the field of view, if there is a box; None without a box."""
        if self.box is None or self.background is None:
            return None
        return self.background if self.outside is None else self.background & ~self.outside

    def with_outside(self, outside: Bool) -> Prompts:
        """Return the prompts with pixels (H, W) added that are outside the field of view."""
        if not outside.any():
            return self
        background = outside if self.background is None else self.background | outside
        return replace(self, background=background, outside=outside)

    def resized(self, width: int, height: int, scale: float) -> Prompts:
        """Return the prompts for the image resized to ``width`` x ``height``, ``scale`` times as large.

        The box is not scaled.
        """

        def small(region: Bool | None) -> Bool | None:
            if region is None:
                return None
            size = (width, height)
            return np.asarray(cv2.resize(region.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0)

        points = tuple(((u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5) for u, v in self.points)
        limit = np.array([width - 1, height - 1])
        clipped = tuple((float(u), float(v)) for u, v in (np.clip(point, 0, limit) for point in points))
        return replace(
            self, background=small(self.background), tool=small(self.tool), outside=small(self.outside), points=clipped
        )

    def within(self, window: tuple[slice, slice]) -> Prompts:
        """Return the regions within a window (rows, columns) of the image, without points and box."""
        regions = (self.background, self.tool, self.outside)
        background, tool, outside = (None if region is None else region[window] for region in regions)
        return Prompts(background, tool, outside=outside)


def draw_prompts(
    shape: tuple[int, ...], scale: float, box: Box | None, points: Sequence[Pixel], not_points: Sequence[Pixel]
) -> Prompts:
    """Rasterise prompts for a resized image.

    Parameters
    ----------
    shape
        (H, W, ...) of the resized image.
    scale
        Size of the resized image relative to the full image.
    box, points, not_points
        Prompts in pixels of the full image, as in `dvrk_cmaes.segment.segment`.
    """
    height, width = shape[:2]

    def at(u: float, v: float) -> Pixel:
        column, row = (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5
        return min(max(column, 0.0), width - 1.0), min(max(row, 0.0), height - 1.0)

    def discs(pixels: Sequence[Pixel]) -> Bool | None:
        if not pixels:
            return None
        v, u = np.mgrid[:height, :width]
        radius = max(_RADIUS * scale, 0.75)
        return np.asarray(np.any([np.hypot(u - x, v - y) <= radius for x, y in (at(*p) for p in pixels)], axis=0))

    background, scaled = discs(not_points), None
    if box is not None:
        scaled = (*at(*box[:2]), *at(*box[2:]))
        outside = np.ones((height, width), np.bool_)
        rows, columns = (slice(math.ceil(max(scaled[k] - 0.5, 0)), int(scaled[k + 2] + 1.5)) for k in (1, 0))
        outside[rows, columns] = False
        background = outside if background is None else background | outside
    return Prompts(background, discs(points), tuple(at(*pixel) for pixel in points), scaled)
