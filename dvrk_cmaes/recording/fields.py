"""Fields of interlaced pictures: the even and the odd rows, which were taken half a frame apart in time."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np

from dvrk_cmaes.geometry import Image

_COMB = 15.0  # grey levels by which a pixel of a comb differs from both neighbours above and below
_ALIKE = 8.0  # grey levels by which it differs at most from the next rows of its own field
_LEAST_SHARE = 0.002  # of the picture, in combs


def of_fields(picture: Image, first: Literal["top", "bottom"]) -> tuple[Image, Image]:
    """Return both fields of a picture (H, W, 3) in the order of time, each in full height, its rows interpolated."""
    height, width = picture.shape[:2]
    fields = []
    for parity in (0, 1):
        rows = (np.arange(height, dtype=np.float32) - parity) / 2
        columns = np.broadcast_to(np.arange(width, dtype=np.float32), (height, width))
        at = np.broadcast_to(rows[:, None], (height, width))
        own = cv2.remap(
            picture[parity::2], columns.copy(), at.copy(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        fields.append(np.asarray(own, np.uint8))
    top, bottom = fields
    return (top, bottom) if first == "top" else (bottom, top)


def looks_interlaced(picture: Image) -> bool:
    """Whether a picture (H, W, 3) has combs: rows that differ from both neighbours alike, but not from their field."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(np.float32)
    middle, above, below = grey[2:-2], grey[1:-3], grey[3:-1]
    own = np.maximum(np.abs(middle - grey[:-4]), np.abs(middle - grey[4:]))
    comb = np.minimum(np.abs(middle - above), np.abs(middle - below)) * np.sign((middle - above) * (middle - below))
    return bool(((comb > _COMB) & (own < _ALIKE)).mean() > _LEAST_SHARE)
