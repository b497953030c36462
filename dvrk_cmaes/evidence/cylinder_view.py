"""Projection of a cylinder: the two lines that bound it in the image of a pinhole camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


def project_cylinder(point: Float64, direction: Float64, radius: float) -> Float64:
    """Compute both outline edges of a cylinder as homogeneous lines in normalised coordinates, (..., 2, 3).

    A line (A, B, C) is the set of points with A X + B Y + C = 0. ``point`` (..., 3) on the axis, m, and the unit vector
    ``direction`` (..., 3) are in the camera's frame; ``radius`` is in m. The result is NaN where the camera centre is
    inside the cylinder.
    """
    k = (point * direction).sum(axis=-1, keepdims=True)
    square = (point * point).sum(axis=-1, keepdims=True) - k**2 - radius**2
    with np.errstate(invalid="ignore", divide="ignore"):
        first = radius * (point - direction * k) / np.sqrt(square)
    second = np.cross(direction, point)
    return np.stack([first + second, first - second], axis=-2)
