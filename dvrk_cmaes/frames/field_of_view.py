"""Detection of what surrounds the picture in an endoscope's image: a lens's black rim, or bars of one level.

A border is grey and meets the image's edge, so colours and contact with the edge do not distinguish it from a shaft. It
is therefore excluded, and an instrument may enter the picture from it as from the image's edge. A border is dark, or of
one level up to the noise of compression, and may have any convex picture in it, and texts beside that.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from dvrk_cmaes.geometry import Bool, Image

IGNORED = "the border around the picture is ignored"

_BLACK = 11  # grey levels, brightness (largest channel) up to which a pixel is black
_BLUR = 1.5  # px, standard deviation of the Gaussian that smooths the image
_LEVEL = 6  # grey levels, largest difference of a border's pixel from its level, in each channel of a smoothed image
_LEAST_CORNERS = 2  # least number of the image's corners that are in a border
_LEAST_SHARE = 0.01  # least share of the image that is black, or of one level
_LEAST_PICTURE = 0.35  # least share of the image that a picture in a border of one level has, ...
_LEAST_FILLED = 0.8  # ... and of the picture that is not of that level: else it is an object before a plain background
_WHOLE_SIDE = 0.8  # share of a side of the image, which texts may interrupt, that a border of one level has
_UNMARKED, _MARKED = 255, 128  # of pixels like a border, and of those connected to a corner
_RIM = 4  # px, width of the transition at the edge of the picture


def outside_view(image: Image) -> Bool:
    """Return the pixels (H, W) of an image (H, W, 3) that lie outside the picture.

    Regions that are black, or of the level of a corner, are a border if they contain at least two of the image's
    corners and 1 % of its pixels. The picture is the convex hull of the largest part of the other pixels, for it also
    contains a dark shaft that is connected to the border; the result is what is outside of it, widened by the edge's
    transition. A border that is not black must have a whole side of the image, or all corners, and the picture not much
    of its level: an object before a plain background has no border. Otherwise, or if the image is all border, no pixel
    is outside.
    """
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), _BLUR, borderType=cv2.BORDER_REPLICATE), np.uint8)
    inside = np.ones(image.shape[:2], np.bool_)
    for border, plain in _borders(smooth):
        picture = _picture(border)
        if picture is None:
            continue
        filled = np.count_nonzero(picture & ~border) / np.count_nonzero(picture)
        if not plain or (_surrounds(border) and picture.mean() >= _LEAST_PICTURE and filled >= _LEAST_FILLED):
            inside &= picture
    if inside.all():
        return ~inside
    outside = np.asarray(cv2.dilate((~inside).astype(np.uint8), np.ones((2 * _RIM + 1,) * 2, np.uint8)) > 0)
    return np.zeros_like(outside) if outside.all() else outside


def _borders(smooth: Image) -> Iterator[tuple[Bool, bool]]:
    """Yield the pixels (H, W) connected to corners that are black, or of a corner's level, and whether of a level."""
    height, width = smooth.shape[:2]
    corners = [(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)]
    levels = np.array([smooth[v, u] for u, v in corners], np.int16)
    ranges = [(np.zeros(3), np.full(3, float(_BLACK)))] if np.count_nonzero(levels.max(axis=1) <= _BLACK) > 1 else []
    for number, level in enumerate(levels):
        near = np.abs(levels - level).max(axis=1) <= _LEVEL
        if np.count_nonzero(near) >= _LEAST_CORNERS and np.argmax(near) == number and level.max() > _BLACK - _LEVEL:
            ranges.append((level - float(_LEVEL), level + float(_LEVEL)))
    for low, high in ranges:
        like = cv2.inRange(smooth, low, high)
        begun = [corner for corner in corners if like[corner[::-1]]]
        if len(begun) < _LEAST_CORNERS:
            continue
        for corner in begun:
            if like[corner[::-1]] == _UNMARKED:
                cv2.floodFill(like, None, corner, _MARKED)
        border = like == _MARKED
        if border.mean() >= _LEAST_SHARE and not border.all():
            yield border, bool(low.any())


def _surrounds(border: Bool) -> bool:
    """Whether a border (H, W) has nearly the whole of a side of the image, or all of its corners."""
    sides = border[0], border[-1], border[:, 0], border[:, -1]
    return max(side.mean() for side in sides) >= _WHOLE_SIDE or bool(border[[0, 0, -1, -1], [0, -1, 0, -1]].all())


def _picture(border: Bool) -> Bool | None:
    """Return the convex hull (H, W) of the largest connected part that is not border; None without one."""
    contours, _ = cv2.findContours((~border).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if not contours:
        return None
    hull = cv2.convexHull(max(contours, key=cv2.contourArea))
    return np.asarray(cv2.fillConvexPoly(np.zeros(border.shape, np.uint8), hull, 1) > 0)
