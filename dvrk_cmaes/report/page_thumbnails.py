"""Small pictures of overlays, for a page that holds a thousand of them."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path

import cv2

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.images import read_image
from dvrk_cmaes.report.overlay import LEGEND
from dvrk_cmaes.report.panels import footer, header
from dvrk_cmaes.result import Result

WIDTH = 288  # px
LARGEST = 9000  # bytes
_QUALITIES = (50, 35, 20, 8)  # of JPEG; the first that is small enough, or the last
_TALLEST = 1.25  # of the width; what is higher is narrowed


@dataclass(frozen=True)
class Thumbnail:
    """A picture as a ``data:`` address, and its size in px."""

    address: str
    width: int
    height: int


def thumbnail(overlay: Path | None, result: Result) -> Thumbnail | None:
    """Shrink an overlay without its strips of text; None where there is none that can be read.

    Parameters
    ----------
    overlay
        The picture that ``draw_overlay`` made of the result.
    result
        Its words, which say how high the strips are.
    """
    if overlay is None:
        return None
    try:
        picture = read_image(overlay, halved=True)
    except InputError:
        return None
    height, width = picture.shape[:2]
    unit = width / 1280
    above = header(result, width, unit).shape[0]
    below = footer(result, LEGEND, width, unit).shape[0]
    if above + below < height / 2:  # else it is some other picture
        picture = picture[above : height - below]
    height, width = picture.shape[:2]
    scale = min(WIDTH / width, _TALLEST * WIDTH / height)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    for quality in _QUALITIES:
        encoded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1])[1]
        if len(encoded) <= LARGEST:
            break
    return Thumbnail("data:image/jpeg;base64," + base64.b64encode(encoded.tobytes()).decode("ascii"), *size)
