"""Where the endoscope sees nothing: the black around a round picture.

Black is as grey as a shaft, and it meets the image's border as an instrument does. It is what instruments come in from.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Bool = NDArray[np.bool_]

_BLACK = 12.0  # grey levels, of the brightest channel
_BLUR = 1.5  # px
_LEAST_CORNERS = 2  # of the image that are black
_LEAST_SHARE = 0.01  # of the image
_RIM = 4  # px that a lens's edge fades over


def outside_view(image: NDArray[np.uint8]) -> Bool:
    """Pixels (H, W) of an image (H, W, 3) that are outside the round picture of a lens; none where it fills the image.

    Black regions at the image's corners, if they are at two corners or more, and of these what is outside the convex
    hull of the rest: a lens's picture is convex, and a dark shaft that runs into the black is a notch in it.
    """
    brightness = cv2.GaussianBlur(image.max(axis=2).astype(np.float32), (0, 0), _BLUR)
    _, labels = cv2.connectedComponents((brightness < _BLACK).astype(np.uint8), connectivity=4)
    corners = labels[[0, 0, -1, -1], [0, -1, 0, -1]]
    black = np.isin(labels, corners[corners > 0])
    if np.count_nonzero(corners) < _LEAST_CORNERS or black.mean() < _LEAST_SHARE or black.all():
        return np.zeros(black.shape, np.bool_)
    hull = cv2.convexHull(cv2.findNonZero((~black).astype(np.uint8)))
    inside = cv2.fillConvexPoly(np.zeros(black.shape, np.uint8), hull, 1) > 0
    return np.asarray(cv2.dilate((~inside).astype(np.uint8), np.ones((2 * _RIM + 1,) * 2, np.uint8)) > 0)
