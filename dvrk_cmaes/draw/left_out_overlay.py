"""Drawing of a leave-one-out prediction: the silhouette predicted by a session's other frames, over a frame's mask.

It shows the two outlines, cropped to the region around them, at a fixed small size.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.canvas import DARK, GREY, WHITE, Canvas, Colour, plain
from dvrk_cmaes.draw.panels import MASK
from dvrk_cmaes.geometry import Bool, Float64

SIZE = 640, 480
"""Width and height of the drawing, px; below it is a strip of text."""

PREDICTED: Colour = (255, 120, 230)  # pink, which occurs neither in tissue nor on metal

_STRIP = 34  # px
_BACKGROUND: Colour = (52, 46, 43)
_MARGIN = 0.12  # margin on each side, as a fraction of the outlines' extent
_LEAST_SHARE = 0.35  # least width of the crop, as a fraction of the image's
_FAINT = 0.22  # brightness of the mask where there is no image, 0 to 1


def draw_left_out(
    mask: Bool, predicted: Bool, iou: float, contour_px: float, *, image: NDArray[np.uint8] | None = None
) -> NDArray[np.uint8]:
    """Draw a predicted silhouette over a frame.

    Parameters
    ----------
    mask, predicted
        (H, W) bool, the frame's mask, and the silhouette that the other frames predict.
    iou, contour_px
        Their intersection over union, and the median distance of their contours, px; written into the drawing.
    image
        (H', W', 3) uint8 BGR with the mask's aspect ratio, the drawing's background.

    Returns
    -------
    (SIZE[1] + strip, SIZE[0], 3) uint8, BGR
        The part of the frame around the outlines, above a strip with the legend and the two numbers.
    """
    to_canvas = _crop_transform(mask | predicted)
    canvas = Canvas(_background(mask, image, to_canvas), 1.0)
    seen, expected = _enlarged(mask, to_canvas), _enlarged(predicted, to_canvas)
    canvas.tint(seen & ~expected, MASK, 0.3)
    canvas.tint(expected & ~seen, PREDICTED, 0.3)
    canvas.outline(seen, MASK)
    canvas.outline(expected, PREDICTED)
    strip = Canvas(plain(_STRIP, SIZE[0], _BACKGROUND), 1.0)
    left, middle = 12.0, _STRIP / 2
    for text, colour in (("mask", MASK), ("predicted by the other frames", PREDICTED)):
        strip.line(np.array([[left, middle], [left + 24, middle]]), colour, width=3.0, rim=False)
        strip.text(text, (left + 32, middle), GREY, size=0.45)
        left += 32 + strip.text_width(text, 0.45) + 18
    figures = f"IoU {iou:.3f}   {contour_px:.1f} px"
    right = SIZE[0] - 12 - strip.text_width(figures, 0.5)
    strip.text(figures, (right, middle), WHITE, size=0.5)
    return np.concatenate([canvas.image, strip.image])


def _crop_transform(drawn: Bool) -> Float64:
    """Return the affine map (2, 3) from the mask's pixels to the canvas that shows a region (H, W) with a margin."""
    height, width = drawn.shape
    v, u = np.nonzero(drawn)
    left, right, top, bottom = (u.min(), u.max(), v.min(), v.max()) if len(u) else (0, width - 1, 0, height - 1)
    share = SIZE[0] / SIZE[1]
    wide = max(right - left + 1, (bottom - top + 1) * share) * (1 + 2 * _MARGIN)
    wide = min(max(wide, _LEAST_SHARE * width), max(width, height * share))
    corner = [_crop_start((left + right) / 2, wide, width), _crop_start((top + bottom) / 2, wide / share, height)]
    scale = SIZE[0] / wide
    return np.array([[scale, 0.0, (0.5 - corner[0]) * scale - 0.5], [0.0, scale, (0.5 - corner[1]) * scale - 0.5]])


def _crop_start(middle: float, extent: float, size: int) -> float:
    """Return the start of an interval of length ``extent`` about ``middle``, shifted to lie within an image's ``size``.

    An interval longer than the image is centred. Coordinates have 0 at the outer edge of the first pixel, whose centre
    is at 0.5; ``middle`` is given with pixel centres at integers.
    """
    if extent >= size:
        return (size - extent) / 2
    return float(np.clip(middle + 0.5 - extent / 2, 0, size - extent))


def _enlarged(mask: Bool, to_canvas: Float64) -> Bool:
    """Warp a mask (H, W) to the canvas with a smoothed outline."""
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 0.7)
    return np.asarray(cv2.warpAffine(smooth, to_canvas, SIZE, flags=cv2.INTER_LINEAR) > 0.5)


def _background(mask: Bool, image: NDArray[np.uint8] | None, to_canvas: Float64) -> NDArray[np.uint8]:
    """Return the background of the outlines on the canvas: the image, or the mask if there is no image."""
    if image is None:
        drawn = plain(SIZE[1], SIZE[0], DARK)
        drawn.reshape(-1, 3)[np.flatnonzero(_enlarged(mask, to_canvas))] = round(255 * _FAINT)
        return drawn
    larger = image.shape[1] / mask.shape[1]
    # map from the image's pixels to the mask's, centres at integers
    to_mask = np.array([[1 / larger, 0, 0.5 / larger - 0.5], [0, 1 / larger, 0.5 / larger - 0.5], [0, 0, 1]])
    from_image = to_canvas @ to_mask
    shrunk = 1 / float(from_image[0, 0])
    source = cv2.GaussianBlur(image, (0, 0), 0.4 * shrunk) if shrunk > 1 else image  # against aliasing
    ground = cv2.warpAffine(source, from_image, SIZE, flags=cv2.INTER_LINEAR, borderValue=DARK)
    return np.asarray(ground, dtype=np.uint8)
