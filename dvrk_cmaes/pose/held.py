"""Thin things that the jaws hold, such as a suture needle or a thread, in a mask: they count neither way."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.evidence.straight_cut import shaft_width
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.geometry import Bool, Posed
from dvrk_cmaes.pose.views import FrameView

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
