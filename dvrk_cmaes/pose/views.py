"""The views of one frame that show the instrument, and the evidence in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search.modes import HasPose, Posed
from dvrk_cmaes.silhouette import Renderer

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrameView:
    """One view of a frame: its name, evidence, renderer at full detail, and ``view_from_camera`` (4, 4), m."""

    name: str
    evidence: Evidence
    renderer: Renderer
    view_from_camera: Float64

    def sees(self, fit: HasPose) -> Posed:
        """Return a pose of the reference camera in this view's camera."""
        return Posed(self.view_from_camera @ fit.camera_from_root, fit.joints, fit.score)


def without_readings(readings: Readings) -> Readings:
    """Return readings that say nothing, for all views but the first: readings and limits count once a frame."""
    unknown = np.full_like(readings.values, np.nan)
    return replace(readings, values=unknown, low=np.full_like(unknown, -np.inf), high=np.full_like(unknown, np.inf))


def clearest_view(views: Sequence[FrameView]) -> FrameView:
    """Return the view with the largest mask, in solid angle; the first of equals."""

    def seen(view: FrameView) -> float:
        camera, evidence = view.evidence.camera, view.evidence
        return float((evidence.mask * evidence.weight).sum()) / (camera.fx * camera.fy)

    return max(views, key=seen)
