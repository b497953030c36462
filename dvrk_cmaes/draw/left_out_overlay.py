"""The picture of what the other frames of a session predict for a frame, without its image, over what is seen in it.

Smaller and plainer than a result's overlay, for a page that shows many: two outlines, cut to where they are.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.canvas import DARK, GREY, WHITE, Canvas, Colour
from dvrk_cmaes.draw.overlay import MASK

Float64 = NDArray[np.float64]

SIZE = 640, 480
"""Width and height of the drawing, px; below it is a strip of text."""

PREDICTED: Colour = (255, 120, 230)  # a pink that neither tissue nor metal has

_STRIP = 34  # px
_GROUND: Colour = (52, 46, 43)
_BESIDE = 0.12  # of the outlines' extent, left free on each side
_LEAST_SHARE = 0.35  # of the image's width that is always shown
_FAINT = 0.22  # of white, for the mask where there is no image


def draw_left_out(
    mask: NDArray[np.bool_],
    predicted: NDArray[np.bool_],
    iou: float,
    contour_px: float,
    *,
    image: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """Draw a predicted silhouette over a frame.

    Parameters
    ----------
    mask, predicted
        (H, W) bool, the instrument as it is seen and as the other frames predict it.
    iou, contour_px
        How well they agree: overlap, and median distance of the contours, px.
    image
        (H', W', 3) uint8 BGR of the mask's aspect, to draw on.

    Returns
    -------
    (SIZE[1] + strip, SIZE[0], 3) uint8, BGR
        The part of the frame where the outlines are, above a strip of legend and figures.
    """
    to_canvas = _cut(mask | predicted)
    canvas = Canvas(_ground(mask, image, to_canvas), 1.0)
    seen, expected = _enlarged(mask, to_canvas), _enlarged(predicted, to_canvas)
    canvas.tint(seen & ~expected, MASK, 0.3)
    canvas.tint(expected & ~seen, PREDICTED, 0.3)
    canvas.outline(seen, MASK)
    canvas.outline(expected, PREDICTED)
    strip = Canvas(np.full((_STRIP, SIZE[0], 3), _GROUND, np.uint8), 1.0)
    left, middle = 12.0, _STRIP / 2
    for text, colour in (("mask", MASK), ("predicted by the other frames", PREDICTED)):
        strip.line(np.array([[left, middle], [left + 24, middle]]), colour, width=3.0, rim=False)
        strip.text(text, (left + 32, middle), GREY, size=0.45)
        left += 32 + strip.text_width(text, 0.45) + 18
    figures = f"IoU {iou:.3f}   {contour_px:.1f} px"
    right = SIZE[0] - 12 - strip.text_width(figures, 0.5)
    strip.text(figures, (right, middle), WHITE, size=0.5)
    return np.concatenate([canvas.image, strip.image])


def _cut(drawn: NDArray[np.bool_]) -> Float64:
    """Find the map (2, 3) from an image's pixels to the canvas's that shows what is drawn (H, W), and a little more."""
    height, width = drawn.shape
    v, u = np.nonzero(drawn)
    left, right, top, bottom = (u.min(), u.max(), v.min(), v.max()) if len(u) else (0, width - 1, 0, height - 1)
    share = SIZE[0] / SIZE[1]
    wide = max(right - left + 1, (bottom - top + 1) * share) * (1 + 2 * _BESIDE)
    wide = min(max(wide, _LEAST_SHARE * width), max(width, height * share))
    corner = [
        _corner((left + right) / 2, wide, width),
        _corner((top + bottom) / 2, wide / share, height),
    ]
    scale = SIZE[0] / wide
    return np.array([[scale, 0.0, (0.5 - corner[0]) * scale - 0.5], [0.0, scale, (0.5 - corner[1]) * scale - 0.5]])


def _corner(middle: float, extent: float, size: int) -> float:
    """Where to begin, so that an extent about a middle does not reach beyond an image of a size, or evenly if it must.

    Corners are those of pixels, whose centres are at integers: 0 is the outer edge of the first.
    """
    if extent >= size:
        return (size - extent) / 2
    return float(np.clip(middle + 0.5 - extent / 2, 0, size - extent))


def _enlarged(mask: NDArray[np.bool_], to_canvas: Float64) -> NDArray[np.bool_]:
    """Bring a mask to the canvas, its outline without stairs."""
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 0.7)
    return np.asarray(cv2.warpAffine(smooth, to_canvas, SIZE, flags=cv2.INTER_LINEAR) > 0.5)


def _ground(mask: NDArray[np.bool_], image: NDArray[np.uint8] | None, to_canvas: Float64) -> NDArray[np.uint8]:
    """Draw what is below the outlines: the image, or the mask where there is none."""
    if image is None:
        drawn = np.full((SIZE[1], SIZE[0], 3), DARK, dtype=np.uint8)
        drawn[_enlarged(mask, to_canvas)] = round(255 * _FAINT)
        return drawn
    larger = image.shape[1] / mask.shape[1]
    # pixels of the image, centres at integers, to those of the mask
    to_mask = np.array([[1 / larger, 0, 0.5 / larger - 0.5], [0, 1 / larger, 0.5 / larger - 0.5], [0, 0, 1]])
    from_image = to_canvas @ to_mask
    shrunk = 1 / float(from_image[0, 0])
    source = cv2.GaussianBlur(image, (0, 0), 0.4 * shrunk) if shrunk > 1 else image  # what is shrunk flickers otherwise
    ground = cv2.warpAffine(source, from_image, SIZE, flags=cv2.INTER_LINEAR, borderValue=DARK)
    return np.asarray(ground, dtype=np.uint8)
