"""Outline of a cylinder in the image: the two lines in which a pinhole camera sees its edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


def project_cylinder(point: Float64, direction: Float64, radius: float) -> Float64:
    """Both outline edges of a cylinder as homogeneous lines A X + B Y + C = 0 in normalised coordinates, (..., 2, 3).

    ``point`` (..., 3) on the axis, m, ``direction`` (..., 3) unit, in the camera's frame. Not a number where the eye
    is inside the cylinder.
    """
    k = (point * direction).sum(axis=-1, keepdims=True)
    square = (point * point).sum(axis=-1, keepdims=True) - k**2 - radius**2
    with np.errstate(invalid="ignore", divide="ignore"):
        first = radius * (point - direction * k) / np.sqrt(square)
    second = np.cross(direction, point)
    return np.stack([first + second, first - second], axis=-2)
