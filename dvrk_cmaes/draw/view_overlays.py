"""Overlays of a result over all views of its frame, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dvrk_cmaes.draw.canvas import WHITE, Canvas, beside
from dvrk_cmaes.draw.overlay import draw_overlay
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.geometry import Image
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body

_TOP = 0.12  # share of the height at which a view's name stands, below the strip of text


def drawn_views(views: Sequence[SeenView]) -> list[SeenView]:
    """Return the views of a frame that are drawn: those whose mask is not empty, and the only one in any case."""
    return [view for view in views if view.mask.any() or len(views) == 1]


def draw_views(result: Result, views: Sequence[SeenView], body: Body, evidence: Evidence | None = None) -> Image:
    """Draw a result over each view of a frame that is drawn, as `draw_overlay`, side by side; (h, w, 3) uint8 BGR.

    ``evidence`` is that of the mask of a single view, where known. Where there are several views, the name of each is
    written into its upper left corner, and neither ignored pixels nor given jaw tips are drawn.
    """
    if len(views) == 1:
        (view,) = views
        return draw_overlay(
            result,
            view.mask,
            view.camera,
            body,
            image=view.image,
            ignore=view.ignore,
            keypoints=view.keypoints,
            evidence=evidence,
        )
    drawn = []
    for view in drawn_views(views):
        pose = result.camera_from_root
        seen = replace(result, camera_from_root=None if pose is None else view.view_from_camera @ pose)
        overlay = draw_overlay(seen, view.mask, view.camera, body, image=view.image)
        canvas = Canvas(overlay, overlay.shape[1] / 1280)
        canvas.text(view.name, (16 * canvas.unit, _TOP * overlay.shape[0]), WHITE, size=0.8, rim=True)
        drawn.append(canvas.image)
    return beside(drawn)
