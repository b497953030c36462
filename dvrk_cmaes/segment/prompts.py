"""Prompts as regions of an image: pixels known to be instrument and pixels known to be background."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from dvrk_cmaes.frames.field_of_view import outside_view
from dvrk_cmaes.geometry import Bool, Image
from dvrk_cmaes.segment.segmentation import Box, Hints, Pixel

_RADIUS = 4.0  # px of the full image, radius of the disc about a point


@dataclass(frozen=True, eq=False)
class Prompts:
    """Prompts in pixels of the image at one size.

    background, tool : (H, W) bool, pixels known to be background or instrument.
    outside : (H, W) bool, pixels outside the field of view, also part of ``background``.
    points : pixels (u, v) on the instrument. box : left, top, right, bottom of a box around it.
    """

    background: Bool
    tool: Bool
    outside: Bool
    points: tuple[Pixel, ...] = ()
    box: Box | None = None

    @property
    def given(self) -> bool:
        """Whether there is a box or a point on the instrument."""
        return self.box is not None or bool(self.points)

    def with_outside(self, outside: Bool) -> Prompts:
        """Return the prompts with pixels (H, W) that are outside the field of view."""
        return replace(self, background=self.background | outside, outside=outside)

    def resized(self, width: int, height: int, scale: float) -> Prompts:
        """Return the prompts for the image resized to ``width`` x ``height``, ``scale`` times as large.

        The box is not scaled.
        """
        background, tool, outside = (
            cv2.resize(region.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
            for region in (self.background, self.tool, self.outside)
        )
        points = tuple(_scaled(point, scale, (height, width)) for point in self.points)
        return replace(self, background=background, tool=tool, outside=outside, points=points)


def no_prompts(shape: tuple[int, ...]) -> Prompts:
    """Return no prompts for an image of a shape (H, W, ...)."""
    nowhere = np.zeros(shape[:2], np.bool_)
    return Prompts(nowhere, nowhere, nowhere)


def draw_prompts(image: Image, hints: Hints, scale: float = 1.0) -> Prompts:
    """Rasterise prompts for an image (H, W, 3), and find what is outside its field of view.

    ``hints`` are in pixels of the full image, of which this one has a size of ``scale``.
    """
    height, width = shape = image.shape[:2]

    def discs(pixels: Sequence[Pixel]) -> Bool:
        v, u = np.ogrid[:height, :width]
        found, radius = np.zeros(shape, np.bool_), max(_RADIUS * scale, 0.75)
        for x, y in (_scaled(pixel, scale, shape) for pixel in pixels):
            found |= np.hypot(u - x, v - y) <= radius
        return found

    background, box = discs(hints.not_points), None
    if hints.box is not None:
        box = (*_scaled(hints.box[:2], scale, shape), *_scaled(hints.box[2:], scale, shape))
        rows, columns = (slice(math.ceil(max(box[k] - 0.5, 0)), int(box[k + 2] + 1.5)) for k in (1, 0))
        beyond = np.ones(shape, np.bool_)
        beyond[rows, columns] = False
        background |= beyond
    points = tuple(_scaled(point, scale, shape) for point in hints.points)
    outside = outside_view(image)
    return Prompts(background | outside, discs(hints.points), outside, points, box)


def _scaled(pixel: Pixel, scale: float, shape: tuple[int, int]) -> Pixel:
    """Return where a pixel is in an image of a shape (H, W) that is ``scale`` times as large, within its limits."""
    u, v = ((each + 0.5) * scale - 0.5 for each in pixel)
    return min(max(u, 0.0), shape[1] - 1.0), min(max(v, 0.0), shape[0] - 1.0)
