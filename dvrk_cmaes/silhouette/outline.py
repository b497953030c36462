"""Points on the outline of the silhouette, in the image and on the instrument's surface.

To first order, a small motion of the instrument moves its outline along the image normals by as much as it moves the
surface points that project onto the outline. The derivatives of sums over the silhouette therefore follow from the
three-dimensional points of the outline, without rendering further silhouettes. A point is located best on an image line
that crosses the outline at a large angle: rows are used where the outline is steep, columns where it is flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Float64


@dataclass(frozen=True, eq=False)
class OutlinePoints:
    """Points on the outline of one pose, sorted by link.

    link : (N,) index of the link. pixels : (N, 2). normals : (N, 2), pointing out of the silhouette; their length is
    that of the piece of outline, px, that the point represents. points : (N, 3) on the instrument's surface, m, in the
    link's frame.
    """

    link: NDArray[np.integer[Any]]
    pixels: Float64
    normals: Float64
    points: Float64

    def every(self, stride: int) -> OutlinePoints:
        """Return every ``stride``-th point, which represents the pieces of outline of those beside it, too."""
        if stride == 1:
            return self
        part = slice(None, None, stride)
        return OutlinePoints(self.link[part], self.pixels[part], stride * self.normals[part], self.points[part])
