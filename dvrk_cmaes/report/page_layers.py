"""Full pictures within the page: overlays, and the layers of the frames' drawings."""

from __future__ import annotations

from pathlib import Path

import cv2

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.report.page_thumbnails import webp_address
from dvrk_cmaes.results.layers import FrameLayers, Outline, read_layers

EMBEDDED = 1_150_000
"""Size in bytes from which on no more full pictures are put into the page, about 40 frames of 640 x 480 px."""

_QUALITY = 50  # of WebP


def embedded_picture(path: Path, widest: int = 1280) -> str | None:
    """Return a picture of at most ``widest`` px as a ``data:`` address of WebP; None if it cannot be read."""
    try:
        picture = read_image(path)
    except InputError:
        return None
    height, width = picture.shape[:2]
    if width > widest:
        size = widest, max(1, round(height * widest / width))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(picture.dtype)
    return webp_address(picture, _QUALITY)


def embedded_layers(path: Path) -> FrameLayers | None:
    """Read the layers of a frame for the page; None if they cannot be read."""
    try:
        return read_layers(path)
    except InputError:
        return None


def size_of_layers(layers: FrameLayers | None) -> int:
    """Return the size of a frame's layers in the page, bytes."""
    return 0 if layers is None else len(layers.picture or "") + sum(map(len, map(outline_path, layers.outlines)))


def outline_path(outline: Outline) -> str:
    """Return an outline as an SVG path whose coordinates are 0 at the outer edge of the first pixel."""
    rings = []
    for ring in outline.rings:
        points = [f"{u + 0.5:.4g} {v + 0.5:.4g}" for u, v in zip(ring[::2], ring[1::2], strict=False)]
        rings.append(f"M{points[0]}L{' '.join(points[1:])}z")
    return "".join(rings)
