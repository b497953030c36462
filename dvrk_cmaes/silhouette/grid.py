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


@dataclass(frozen=True)
class Projection:
    """From points in the camera's frame to positions along the lines (u) and among them (v, a real line number)."""

    camera: Camera
    grid: LineGrid

    @cached_property
    def image_from_camera(self) -> NDArray[np.float64]:
        """(3, 3): normalised, distorted coordinates to u and v."""
        camera, n = self.camera, self.grid.per_pixel
        if self.grid.vertical:
            rows = [[0, camera.fy, camera.cy], [camera.fx * n, 0, (camera.cx + 0.5) * n - 0.5]]
        else:
            rows = [[camera.fx, 0, camera.cx], [0, camera.fy * n, (camera.cy + 0.5) * n - 0.5]]
        return np.array([*rows, [0, 0, 1]], dtype=np.float64)

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3): what the camera's frame is multiplied with before the division by depth."""
        return self.image_from_camera if self.camera.is_pinhole else np.eye(3)

    def bent(self, xy: Float32) -> Float32:
        """Undistorted normalised coordinates (2, N) to u and v, (2, N); unchanged for a pinhole, which has them."""
        if self.camera.is_pinhole:
            return xy
        distorted = self.camera.distort(xy.T).T
        m = self.image_from_camera.astype(np.float32)
        if self.grid.vertical:
            distorted = distorted[::-1]
        scale = m[:2, :2].sum(axis=1)
        return np.asarray(distorted * scale[:, None] + m[:2, 2:])

    def first_line(self, v: Float32) -> NDArray[np.signedinteger[Any]]:
        """Give the first line at or below points, within the image."""
        first = np.ceil(v)
        np.clip(first, 0, self.grid.lines, out=first)
        return first.astype(np.int16 if self.grid.lines < 2**15 else np.int32)
