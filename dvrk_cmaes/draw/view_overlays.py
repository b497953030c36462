"""Overlays of a result over all views of its frame, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.canvas import DARK, WHITE, Canvas
from dvrk_cmaes.draw.overlay import draw_overlay
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body

_TOP = 0.12  # share of the height at which a view's name stands, below the strip of text


@dataclass(frozen=True, eq=False)
class DrawnView:
    """A view to draw: its name, mask (H, W), camera, ``view_from_camera`` (4, 4), image and ignored pixels (H, W)."""

    name: str
    mask: NDArray[np.bool_]
    camera: Camera
    view_from_camera: NDArray[np.float64]
    image: NDArray[np.uint8] | None = None
    ignore: NDArray[np.bool_] | None = None


def draw_views(result: Result, views: Sequence[DrawnView], body: Body) -> NDArray[np.uint8]:
    """Draw a result over each view, as `draw_overlay`, beside each other in their order; (h, w, 3) uint8 BGR.

    The name of each view is written into its upper left corner.
    """
    drawn = []
    for view in views:
        pose = result.camera_from_root
        seen = replace(result, camera_from_root=None if pose is None else view.view_from_camera @ pose)
        overlay = draw_overlay(seen, view.mask, view.camera, body, image=view.image, ignore=view.ignore)
        canvas = Canvas(overlay, overlay.shape[1] / 1280)
        canvas.text(view.name, (16 * canvas.unit, _TOP * overlay.shape[0]), WHITE, size=0.8, rim=True)
        drawn.append(canvas.image)
    height = max(each.shape[0] for each in drawn)
    padded = [_padded(each, height) for each in drawn]
    return np.concatenate(padded, axis=1)


def _padded(drawing: NDArray[np.uint8], height: int) -> NDArray[np.uint8]:
    """Return a drawing with dark rows below, up to a height."""
    below = np.full((height - drawing.shape[0], drawing.shape[1], 3), DARK, dtype=np.uint8)
    return np.concatenate([drawing, below])
