"""Drawing of a mask over its image: the outline, the prompts, the confidence and the notes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.canvas import DARK, GREEN, ORANGE, SKY_BLUE, VERMILLION, WHITE, YELLOW, Canvas
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.segment import Box, Pixel, Segmentation
from dvrk_cmaes.segment.segmentation import GUESS

_WIDTH = 960  # px, least width of the drawing
_BACKGROUND = (52, 46, 43)
_LINE = 28.0  # units of the canvas from line to line
_FADED = 0.45  # share of the dark colour that is mixed into the background


def draw_segmentation(
    image: NDArray[np.uint8],
    segmentation: Segmentation,
    name: str,
    *,
    box: Box | None = None,
    points: Sequence[Pixel] = (),
    not_points: Sequence[Pixel] = (),
) -> NDArray[np.uint8]:
    """Draw a mask over its image.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    segmentation
        The mask, its confidence and notes.
    name
        Title of the drawing.
    box, points, not_points
        Prompts, as in `dvrk_cmaes.segment.segment`.

    Returns
    -------
    (h, w, 3) uint8, BGR
        A strip of text above the image, which is enlarged by a whole factor if it is narrower than 960 px.
    """
    height, width = image.shape[:2]
    scale = int(np.ceil(_WIDTH / width)) if width < _WIDTH else 1
    size = width * scale, height * scale
    canvas = Canvas(np.ascontiguousarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)), size[0] / 1280)
    mask = cv2.resize(cv2.GaussianBlur(segmentation.mask.astype(np.float32), (0, 0), 0.7), size) > 0.5
    canvas.tint(~mask, DARK, _FADED)
    canvas.outline(mask, YELLOW)

    def at(pixel: Pixel) -> Float64:
        return np.asarray((np.array(pixel) + 0.5) * scale - 0.5)

    if box is not None:
        left, top, right, bottom = box
        corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
        canvas.line(np.stack([at(corner) for corner in corners]), SKY_BLUE, dash=(10, 6))
    for pixel in points:
        canvas.ring(at(pixel), GREEN)
    for pixel in not_points:
        canvas.cross(at(pixel), VERMILLION)
    return np.concatenate([_header(segmentation, name, size[0], canvas.unit), canvas.image])


def _header(segmentation: Segmentation, name: str, width: int, unit: float) -> NDArray[np.uint8]:
    """Draw the strip of text: whether the mask is a guess, its confidence, and the notes."""
    margin = 14 * unit
    probe = Canvas(np.zeros((1, 1, 3), np.uint8), unit)
    notes = [line for note in segmentation.notes for line in probe.wrapped(f"- {note}", width - 2 * margin)]
    strip = np.full((round((_LINE * (1 + len(notes)) + 12) * unit), width, 3), _BACKGROUND, np.uint8)
    canvas = Canvas(strip, unit)
    word, colour = ("A GUESS", ORANGE) if segmentation.confidence < GUESS else ("MASK", GREEN)
    middle = (6 + _LINE / 2) * unit
    badge = canvas.text_width(word, 0.6) + 16 * unit
    canvas.box((margin, middle - 11 * unit), (badge, 22 * unit), colour)
    canvas.text(word, (margin + 8 * unit, middle), DARK, size=0.6)
    share = f"{100 * float(segmentation.mask.mean()):.1f} % of the image"
    text = f"{name}   confidence {segmentation.confidence:.2f}   {share}"
    canvas.text(text, (margin + badge + 14 * unit, middle), WHITE, size=0.6)
    for k, line in enumerate(notes, start=1):
        canvas.text(line, (margin, middle + k * _LINE * unit), colour)
    return canvas.image
