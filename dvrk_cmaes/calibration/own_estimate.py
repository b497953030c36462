"""A frame's estimate without its session, and what the outline there tells of the mask's errors.

It does not change while the session is solved, and is therefore measured once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.views import FrameView, overlap

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OwnEstimate:
    """A frame's pose, to which no session has contributed.

    ``noises`` are those of the contours there, one of each view; ``iou`` is the intersection over union of its
    silhouettes and the masks. ``residual`` is the robust sum of squares of the residuals of coverage there at the whole
    image size, from which the outlines' error is estimated; None where it is not measured.
    """

    at: Posed
    noises: tuple[OutlineNoise, ...]
    iou: float
    residual: float | None = None

    @property
    def lengths(self) -> tuple[float, ...]:
        """Correlation lengths of the contours' errors, px, one of each view."""
        return tuple(noise.length for noise in self.noises)

    def of_view(self, number: int) -> OwnEstimate:
        """Return the same pose with the noise of one view alone; the residual is that of the only view, if it is."""
        alone = len(self.noises) == 1
        return replace(self, noises=(self.noises[number],), residual=self.residual if alone else None)

    @classmethod
    def of(cls, views: Sequence[FrameView], at: Posed) -> OwnEstimate:
        """Measure an estimate in the views that show the instrument."""
        return cls.drawn_as(views, at, [view.silhouette(at) for view in views])

    @classmethod
    def drawn_as(cls, views: Sequence[FrameView], at: Posed, drawn: Sequence[NDArray[np.bool_]]) -> OwnEstimate:
        """Measure an estimate whose silhouettes (H, W) in the views have been drawn."""
        noises = [measure_noise(view.evidence.contour, seen) for view, seen in zip(views, drawn, strict=True)]
        return cls(at, tuple(noises), overlap(views, drawn))
