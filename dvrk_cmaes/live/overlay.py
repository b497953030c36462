"""Overlay of a followed instrument: the silhouette of its pose over the image, and its status."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.canvas import Canvas
from dvrk_cmaes.draw.panels import SILHOUETTE
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.silhouette import Body, Renderer


class LiveOverlay:
    """Draws results over images of one camera; ``state`` says how far the arm's base is known."""

    def __init__(self, body: Body, camera: Camera, state: Callable[[], str] = str) -> None:
        self._state = state
        self._names = body.instrument.joint_names
        self._renderer = Renderer(body, camera, threads=1)

    def __call__(self, image: NDArray[np.uint8], result: TrackResult) -> NDArray[np.uint8]:
        """Return a copy of an image (H, W, 3), BGR, with the outline of a result's silhouette and the status."""
        canvas = Canvas(image.copy(), 1.0)
        if result.camera_from_root is not None:
            joints = np.array([result.joints[name] for name in self._names])
            canvas.outline(self._renderer.masks(result.camera_from_root[None], joints[None])[0], SILHOUETTE)
        text = ": ".join([result.status, *result.reasons[:1]])
        canvas.text(text, (8.0, 14.0), rim=True)
        if state := self._state():
            canvas.text(state, (8.0, 30.0), rim=True)
        return canvas.image
