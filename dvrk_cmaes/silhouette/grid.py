"""Image lines, and how points in the camera's frame fall among them."""

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

    Along vertical lines, u and v change places everywhere: positions are pixel rows and lines count columns.
    """

    pixels: int
    per_pixel: int = 1
    vertical: bool = False

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self.pixels * self.per_pixel

    def line_to_v(self, line: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Pixel row coordinate v of lines, column coordinate u of vertical ones."""
        return np.asarray((line + 0.5) / self.per_pixel - 0.5)

    def place(self, pixels: Float32) -> Float32:
        """Put pixels (2, ...) on the lines: positions along them (u) and among them (v, real line numbers)."""
        n = self.per_pixel
        if self.vertical:
            pixels = pixels[::-1]
        if n == 1:
            return pixels
        return np.stack([pixels[0], pixels[1] * np.float32(n) + np.float32((n - 1) / 2)])

    def first_line(self, v: Float32) -> NDArray[np.signedinteger[Any]]:
        """Give the first line at or below points, within the image."""
        first = np.ceil(v)
        np.clip(first, 0, self.lines, out=first)
        return first.astype(np.int16 if self.lines < 2**15 else np.int32)


@dataclass(frozen=True)
class Projection:
    """From points in the camera's frame to pixels, in two steps around the division by depth."""

    camera: Camera

    @cached_property
    def image_from_camera(self) -> NDArray[np.float64]:
        """(3, 3): normalised, distorted coordinates to pixels u and v."""
        c = self.camera
        return np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]], dtype=np.float64)

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3): what the camera's frame is multiplied with before the division by depth."""
        return self.image_from_camera if self.camera.is_pinhole else np.eye(3)

    def pixels(self, xy: Float32) -> Float32:
        """Undistorted normalised coordinates (2, N) to pixels, (2, N); unchanged for a pinhole, which has them."""
        if self.camera.is_pinhole:
            return xy
        m = self.image_from_camera.astype(np.float32)
        return np.asarray(self.camera.distort(xy.T).T * m[[0, 1], [0, 1], None] + m[:2, 2:])
