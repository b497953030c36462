"""Image lines along which silhouettes are sampled, and the projection of points to pixels and lines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera

Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class LineGrid:
    """Lines through an image: ``per_pixel`` evenly spaced ones in each of ``pixels`` rows, or columns if ``vertical``.

    For vertical lines, u and v are swapped throughout: positions are pixel rows and line numbers count columns.
    """

    pixels: int
    per_pixel: int = 1
    vertical: bool = False

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self.pixels * self.per_pixel

    def line_to_v(self, line: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Return the pixel row coordinate v of lines; for vertical lines, the column coordinate u."""
        return np.asarray((line + 0.5) / self.per_pixel - 0.5)

    def place(self, pixels: Float32) -> Float32:
        """Convert pixels (2, ...) to line coordinates (2, ...): position along the lines (u), real line number (v)."""
        n = self.per_pixel
        if self.vertical:
            pixels = pixels[::-1]
        if n == 1:
            return pixels
        return np.stack([pixels[0], pixels[1] * np.float32(n) + np.float32((n - 1) / 2)])

    def first_line(self, v: Float32) -> NDArray[np.signedinteger[Any]]:
        """Return the number of the first line at or below each point, clipped to 0 to ``lines``."""
        first = np.ceil(v)
        np.clip(first, 0, self.lines, out=first)
        return first.astype(np.int16 if self.lines < 2**15 else np.int32)


@dataclass(frozen=True)
class Projection:
    """Projection from the camera's frame to pixels in two steps, one before and one after the division by depth."""

    camera: Camera

    @cached_property
    def image_from_camera(self) -> NDArray[np.float64]:
        """(3, 3) matrix from normalised, distorted coordinates to pixels u and v."""
        c = self.camera
        return np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]], dtype=np.float64)

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3) matrix applied to points in the camera's frame before the division by depth."""
        return self.image_from_camera if self.camera.is_pinhole else np.eye(3)

    def pixels(self, xy: Float32) -> Float32:
        """Convert points (2, N) after the division by depth to pixels (2, N).

        For a camera with distortion these are normalised coordinates; for a pinhole, ``matrix`` has already made them
        pixels and they are returned unchanged.
        """
        if self.camera.is_pinhole:
            return xy
        m = self.image_from_camera.astype(np.float32)
        return np.asarray(self.camera.distort(xy.T).T * m[[0, 1], [0, 1], None] + m[:2, 2:])
