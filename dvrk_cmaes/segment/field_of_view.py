"""Detection of the black area outside an endoscope's circular field of view.

The black area is grey and meets the image's border, so colours and border contact do not distinguish it from a shaft.
It is therefore excluded from the segmentation, and an instrument may enter the picture from it as from the image's
border.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Bool = NDArray[np.bool_]

_BLACK = 12.0  # grey levels, brightness (largest channel) below which a pixel is black
_BLUR = 1.5  # px, standard deviation of the Gaussian that smooths the brightness
_LEAST_CORNERS = 2  # least number of the image's corners that are black
_LEAST_SHARE = 0.01  # least black share of the image
_RIM = 4  # px, width of the dark transition at the edge of the field of view


def outside_view(image: NDArray[np.uint8]) -> Bool:
    """Return the pixels (H, W) of an image (H, W, 3) that lie outside the lens's circular field of view.

    If black regions contain at least two of the image's corners and 1 % of its pixels, the result is the complement of
    the convex hull of all other pixels, widened by the edge's transition. The field of view is convex, so the hull also
    contains a dark shaft that is connected to the black region. Otherwise, or if the image is all black, no pixel is
    outside.
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
