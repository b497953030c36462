"""Coverage of the spans between neighbouring crossings of an image line, decided by one ray for each.

Coverage can change only where a line crosses an outline edge. Whether a span between two crossings is covered is
therefore decided by one ray through any of its points; its middle is farthest from both edges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.grid import LineGrid
from dvrk_cmaes.silhouette.scenes import LinkScenes

METHODS = ("count", "rays")
"""Ways to decide what is covered: the number of layers of faces along the line, or a ray for each span."""


class SpanRays:
    """Traces rays through spans for a batch of poses (C, L, 4, 4), and counts them."""

    def __init__(self, scenes: LinkScenes, camera: Camera, camera_from_link: NDArray[np.float64]) -> None:
        self._scenes = scenes
        self._camera = camera
        self._camera_from_link = camera_from_link
        self.count = 0

    def covered(
        self,
        row: NDArray[np.int32],
        position: NDArray[np.float64],
        grid: LineGrid,
        *,
        to_pixel: bool,
        least: float,
    ) -> NDArray[np.bool_]:
        """Find whether the instrument covers the span from each crossing to the next on its line, (N,).

        ``row`` (N,), pose * lines + line, and ``position`` (N,), px from the image's border, are those of the crossings
        in their order. A span of less than ``least`` px has the value of the one before it; what follows the last
        crossing of a line is not covered. With ``to_pixel`` positions are whole, and the ray passes the centre of a
        pixel of the span.
        """
        last = np.ones(len(row), dtype=np.bool_)
        last[:-1] = row[1:] != row[:-1]
        length = np.zeros(len(row))
        np.subtract(position[1:], position[:-1], out=length[:-1])
        traced = np.flatnonzero(~last & (length >= least))
        middle = position[traced] + 0.5 * length[traced] - 0.5
        if to_pixel:
            middle = np.floor(middle)
        pose, line = np.divmod(row[traced], grid.lines)
        pixels = np.stack([middle, grid.line_to_v(line)], axis=1)
        directions = self._camera.normalise(pixels[:, ::-1] if grid.vertical else pixels)
        found = self._scenes.covered(
            self._camera_from_link, pose.astype(np.intp), np.column_stack([directions, np.ones(len(pixels))])
        )
        self.count += len(traced)
        result = np.zeros(len(row), dtype=np.bool_)
        result[traced] = found
        decided = last
        decided[traced] = True
        latest = np.maximum.accumulate(np.where(decided, np.arange(len(row)), -1))
        return np.asarray(result[latest] & (latest >= 0))
