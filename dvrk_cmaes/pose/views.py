"""The views of one frame that show the instrument, and the evidence in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.camera import View
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise
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
