"""Drawing of a mask over its image: the outline, the prompts, the confidence and the notes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.canvas import DARK, GREEN, ORANGE, SKY_BLUE, VERMILLION, WHITE, YELLOW, Canvas, strip
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.segment.segmentation import GUESS, Hints, Pixel, Segmentation

_WIDTH = 960  # px, least width of the drawing
_FADED = 0.45  # share of the dark colour that is mixed into the background


def draw_segmentation(
    image: NDArray[np.uint8],
    segmentation: Segmentation,
    name: str,
    hints: Hints,
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
    hints
        Prompts, which are drawn, too.

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

    if hints.box is not None:
        left, top, right, bottom = hints.box
        corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
        canvas.line(np.stack([at(corner) for corner in corners]), SKY_BLUE, dash=(10, 6))
    for pixel in hints.points:
        canvas.ring(at(pixel), GREEN)
    for pixel in hints.not_points:
        canvas.cross(at(pixel), VERMILLION)
    return np.concatenate([_header(segmentation, name, size[0], canvas.unit), canvas.image])


def _header(segmentation: Segmentation, name: str, width: int, unit: float) -> NDArray[np.uint8]:
    """Draw the strip of text: whether the mask is a guess, its confidence, and the notes."""
    word, colour = ("A GUESS", ORANGE) if segmentation.confidence < GUESS else ("MASK", GREEN)
    share = f"{100 * float(segmentation.mask.mean()):.1f} % of the image"
    text = f"{name}, confidence {segmentation.confidence:.2f}, {share}"
    return strip(
        width, unit, [[(word, colour), (text, WHITE)], *([(f"- {note}", colour)] for note in segmentation.notes)]
    )
