"""Thumbnails of overlays, cropped to the instrument and limited in file size."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.panels import MASK, SILHOUETTE, heights
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.results.result import Result

WIDTH = 288  # px
LARGEST = 6000  # bytes, largest size at a quality above the lowest
_QUALITIES = (35, 25, 12, 4)  # WebP qualities; the first that gives a small enough file is used, or the last
_LEAST_SHARE = 0.4  # least width of the crop, as a fraction of the picture's
_MARGIN = 0.06  # margin on each side, as a fraction of the outlines' extent
_LIKE = 50  # largest difference in each channel from an outline's colour; thin lines are blended with the background
_TALLEST = 1.25  # largest ratio of height to WIDTH; taller pictures are reduced further


@dataclass(frozen=True)
class Crop:
    """Part of an overlay between its strips of text: its upper end and its height, as shares of the overlay's width."""

    top: float
    height: float

    @property
    def name(self) -> str:
        """Name of the class in the page's style that shows this part."""
        return f"crop-{round(1e4 * self.top)}-{round(1e4 * self.height)}"

    @property
    def style(self) -> str:
        """Rules of that class."""
        return (
            f".{self.name} {{ aspect-ratio: 1 / {self.height:.4f}; }} "
            f".{self.name} img {{ margin-top: -{100 * self.top:.2f}%; }}"
        )


@dataclass(frozen=True)
class Thumbnail:
    """A picture as a ``data:`` address, its size in px, and the part of the overlay without strips; None if unknown."""

    address: str
    width: int
    height: int
    crop: Crop | None = None


def thumbnail(overlay: Path | None, result: Result) -> Thumbnail | None:
    """Make a thumbnail of the part of an overlay around its outlines; None if there is no readable overlay.

    Parameters
    ----------
    overlay
        Path of the overlay that ``draw_overlay`` made of the result, with its strips of text.
    result
        The result; its texts determine the heights of the strips.
    """
    if overlay is None:
        return None
    try:
        picture = read_image(overlay, halved=True)
    except InputError:
        return None
    height, width = (2 * size for size in picture.shape[:2])
    above, below = heights(result, width, width / 1280)
    crop = None
    if above + below < height / 2:  # otherwise it is another picture than this result's overlay
        crop = Crop(above / width, (height - above - below) / width)
        picture = _around_outlines(picture[-(-above // 2) : (height - below) // 2])
    return encoded_thumbnail(picture, WIDTH, LARGEST, crop)


def encoded_thumbnail(picture: NDArray[np.uint8], widest: int, largest: int, crop: Crop | None = None) -> Thumbnail:
    """Reduce a picture (H, W, 3) BGR to a width, px, and encode it as WebP of at most ``largest`` bytes, if possible.

    WebP has half the bytes of a JPEG that looks alike. ``crop`` is kept with it.
    """
    height, width = picture.shape[:2]
    scale = min(widest / width, _TALLEST * widest / height)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    small = cv2.resize(picture, size, interpolation=method).astype(np.uint8)
    for quality in _QUALITIES:
        address = webp_address(small, quality)
        if len(address) <= largest * 4 // 3:
            break
    return Thumbnail(address, *size, crop)


def webp_address(picture: NDArray[np.uint8], quality: int) -> str:
    """Return a picture (H, W, 3) BGR as a ``data:`` address of WebP."""
    encoded = cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, quality])[1]
    return "data:image/webp;base64," + base64.b64encode(encoded.tobytes()).decode("ascii")


def _around_outlines(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Crop a picture (H, W, 3) to the outlines of mask and silhouette, found by colour; the aspect ratio is kept."""
    height, width = picture.shape[:2]
    drawn = np.zeros((height, width), dtype=bool)
    for colour in (MASK, SILHOUETTE):
        low, high = (np.clip(np.add(colour, by), 0, 255).astype(np.float64) for by in (-_LIKE, _LIKE))
        drawn |= cv2.inRange(picture, low, high) > 0
    v, u = np.nonzero(drawn)
    if not len(u):
        return picture
    left, right = np.percentile(u, [0.5, 99.5])  # a few pixels of the image may have these colours
    top, bottom = np.percentile(v, [0.5, 99.5])
    wanted = max(right - left, (bottom - top) * width / height) * (1 + 2 * _MARGIN)
    wide = min(max(round(wanted), round(_LEAST_SHARE * width)), width)
    high = round(wide * height / width)
    x = min(max(round((left + right - wide) / 2), 0), width - wide)
    y = min(max(round((top + bottom - high) / 2), 0), height - high)
    return picture[y : y + high, x : x + wide]
