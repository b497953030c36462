"""Pictures of a followed recording: its frames with the contours of mask and pose."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.canvas import DARK, GREEN, SKY_BLUE, VERMILLION, YELLOW, Colour

_STATUS: dict[str, Colour] = {"ok": GREEN, "doubtful": YELLOW, "lost": VERMILLION}
_FAINT = 0.25  # brightness of the mask where there is no image
_STRIP = 22  # px, height of the strip with the status


def draw_track(
    image: NDArray[np.uint8] | None,
    mask: NDArray[np.bool_] | None,
    silhouette: NDArray[np.bool_] | None,
    *,
    frame: str,
    status: str,
    reasons: Sequence[str],
    size: tuple[int, int],
) -> NDArray[np.uint8]:
    """Draw the contours of mask (yellow) and silhouette (blue), and a strip with the status, (H, W, 3) BGR.

    ``image`` (H, W, 3) BGR and the masks (H, W) are of the ``size`` (width, height) px; each may be missing.
    """
    drawn = draw_outlines(image, mask, silhouette, size=size)
    drawn[:_STRIP] = (drawn[:_STRIP] * 0.3).astype(np.uint8)
    text = f"{frame}  {status}" + (f": {reasons[0]}" if reasons else "")
    plain = text.encode("ascii", "replace").decode()
    cv2.putText(drawn, plain, (6, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _STATUS[status], 1, cv2.LINE_AA)
    return drawn


def draw_outlines(
    image: NDArray[np.uint8] | None,
    mask: NDArray[np.bool_] | None,
    silhouette: NDArray[np.bool_] | None,
    *,
    size: tuple[int, int],
) -> NDArray[np.uint8]:
    """Draw the contours of mask (yellow) and silhouette (blue) as `draw_track` does, without a strip, (H, W, 3) BGR."""
    width, height = size
    drawn = np.full((height, width, 3), DARK, dtype=np.uint8) if image is None else image.copy()
    if image is None and mask is not None:
        drawn[mask] = (_FAINT * 255 * np.ones(3)).astype(np.uint8)
    for region, colour in ((mask, YELLOW), (silhouette, SKY_BLUE)):
        if region is not None:
            contours, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
            cv2.drawContours(drawn, contours, -1, colour, 1, cv2.LINE_AA)
    return drawn
