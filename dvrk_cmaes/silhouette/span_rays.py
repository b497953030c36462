"""Coverage of the spans between neighbouring crossings of an image line, decided by one ray for each.

Coverage can change only where a line crosses an outline edge. Whether a span between two crossings is covered is
therefore decided by one ray through any of its points; its middle is farthest from both edges.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.silhouette.scenes import LinkScenes

METHODS = ("count", "rays")
"""Ways to decide what is covered: the number of layers of faces along the line, or a ray for each span."""

_SHORTEST = 1 / 256  # px; crossings that are closer may be in the wrong order


class SpanRays:
    """Traces rays through spans of the poses (C, L, 4, 4) that the kernel draws.

    There are ``lines_per_pixel`` rows of crossings a pixel, and one column. With ``to_pixel``, the rays pass the
    centres of pixels. ``count`` is told how many ``rays`` were traced.
    """

    def __init__(
        self,
        scenes: LinkScenes,
        camera: Camera,
        camera_from_link: Float64,
        lines_per_pixel: int,
        *,
        to_pixel: bool,
        count: Callable[..., None],
    ) -> None:
        self._scenes = scenes
        self._camera = camera
        self._camera_from_link = camera_from_link
        self._lines_per_pixel = lines_per_pixel
        self._to_pixel = to_pixel
        self._count = count

    def __call__(self, pose: int, columns: bool, line: NDArray[np.int32], along: Float64) -> Bool:
        """Find whether the instrument covers the line from each crossing of a pose to the next, (N,).

        ``line`` (N,) and the place ``along`` it (N,), px, are those of the crossings in their order. A span that holds
        no pixel's centre, or is too short to be told from crossings in the wrong order, has the value of the one before
        it; what follows the last crossing of a line is not covered.
        """
        extent = self._camera.height if columns else self._camera.width
        start = np.clip(np.ceil(along), 0, extent) if self._to_pixel else np.clip(along, -0.5, extent - 0.5)
        last = np.ones(len(line), dtype=np.bool_)
        last[:-1] = line[1:] != line[:-1]
        length = np.zeros(len(line))
        np.subtract(start[1:], start[:-1], out=length[:-1])
        traced = np.flatnonzero(~last & (length >= (1.0 if self._to_pixel else _SHORTEST)))
        middle = start[traced] + 0.5 * length[traced]
        if self._to_pixel:
            middle = np.floor(middle - 0.5)
        per_pixel = 1 if columns else self._lines_per_pixel
        pixels = np.stack([middle, (line[traced] + 0.5) / per_pixel - 0.5], axis=1)
        directions = self._camera.normalise(pixels[:, ::-1] if columns else pixels)
        found = self._scenes.covered(
            self._camera_from_link[pose : pose + 1],
            np.zeros(len(traced), dtype=np.intp),
            np.column_stack([directions, np.ones(len(pixels))]),
        )
        self._count(rays=len(traced))
        result = np.zeros(len(line), dtype=np.bool_)
        result[traced] = found
        decided = last
        decided[traced] = True
        latest = np.maximum.accumulate(np.where(decided, np.arange(len(line)), -1))
        return np.asarray(result[latest] & (latest >= 0))
