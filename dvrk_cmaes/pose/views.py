"""The views of one frame that show the instrument, and the evidence in each.

Thin things that the jaws hold, such as a suture needle or a thread, in a mask: they count neither way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.camera import View
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise
from dvrk_cmaes.evidence.straight_cut import shaft_width
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.geometry import Bool, Float64, Posed
from dvrk_cmaes.silhouette import Body, Renderer


@dataclass(frozen=True, eq=False)
class FrameView:
    """One view of a frame: its name, evidence, renderer at full detail, and ``view_from_camera`` (4, 4), m."""

    name: str
    evidence: Evidence
    renderer: Renderer
    view_from_camera: Float64

    def silhouette(self, at: Posed) -> Bool:
        """Draw the silhouette (H, W) of one pose in the reference camera."""
        seen = at.seen_from(self.view_from_camera)
        return np.asarray(self.renderer.masks(seen.pose[None], seen.joints[None])[0])

    def noise_at(self, at: Posed) -> OutlineNoise:
        """Estimate the noise of the mask's contour from its distances to the silhouette of one pose."""
        return measure_noise(self.evidence.contour, self.silhouette(at))


def clearest_view(views: Sequence[FrameView]) -> FrameView:
    """Return the view with the largest mask, in solid angle; the first of equals."""

    def seen(view: FrameView) -> float:
        camera, evidence = view.evidence.camera, view.evidence
        return float((evidence.mask * evidence.weight).sum()) / (camera.fx * camera.fy)

    return max(views, key=seen)


def overlap(views: Sequence[FrameView], drawn: Sequence[Bool]) -> float:
    """Return the mean intersection over union of silhouettes and masks, one a view, without ignored pixels."""
    shares = [view.evidence.overlap_with(seen) for view, seen in zip(views, drawn, strict=True)]
    return float(np.mean(shares))


def silhouette_of(at: Posed, view: View, body: Body) -> Bool:
    """Return the silhouette (H, W) in a view of an instrument that is given in the reference camera."""
    seen = at.seen_from(view.view_from_camera)
    return np.asarray(Renderer(body, view.camera, threads=1).masks(seen.pose[None], seen.joints[None])[0])


HELD: Final = "something thin is held in the jaws: its pixels do not count"
"""The remark on a frame in which it was found."""

_THICK: Final = 0.2  # of the shaft's width: a thing that is thicker anywhere is none of these
_REACH: Final = 0.3  # of the shaft's width, that one reaches beyond the silhouette at least
_COVERED: Final = 0.97  # least share of the silhouette that the mask covers: the rest of it fits
_NEAR_PX: Final = 2  # of the silhouette, where its own outline lies


def without(view: SeenView, held: Bool | None) -> SeenView:
    """Return a view whose pixels (H, W) of what is held are ignored."""
    if held is None:
        return view
    return replace(view, ignore=held if view.ignore is None else view.ignore | held)


def held_in(view: FrameView, at: Posed) -> Bool | None:
    """Return the pixels (H, W) of thin things that reach out of a pose's silhouette in a view; None without any."""
    seen, evidence = at.seen_from(view.view_from_camera), view.evidence
    width = shaft_width(view.renderer.body.instrument, evidence.camera, seen.pose)
    silhouette = view.silhouette(at)
    shown = silhouette & (evidence.weight > 0)
    if width is None or not shown.any() or (shown & evidence.mask).sum() < _COVERED * shown.sum():
        return None
    away = cv2.distanceTransform((~silhouette).astype(np.uint8), cv2.DIST_L2, 5)
    beyond = (evidence.mask & (away > _NEAR_PX)).astype(np.uint8)
    thickness = 2 * cv2.distanceTransform(beyond, cv2.DIST_L2, 5)
    count, labels = cv2.connectedComponents(beyond, connectivity=8)
    held = np.zeros_like(silhouette)
    for number in range(1, count):
        own = labels == number
        if thickness[own].max() < _THICK * width and away[own].max() > _REACH * width:
            held |= own
    if not held.any():
        return None
    around = cv2.dilate(held.astype(np.uint8), np.ones((2 * _NEAR_PX + 3,) * 2, np.uint8)) > 0
    return np.asarray(around & ~silhouette)
