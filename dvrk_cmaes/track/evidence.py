"""What the images of one time say about where the outlines lie."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.track.drawn_outline import DrawnOutline
from dvrk_cmaes.track.edges import OWN_VARIANCE, EdgeDistances, Pass
from dvrk_cmaes.track.image_evidence import ImageEvidence
from dvrk_cmaes.track.mask_evidence import MaskEvidence

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Evidence:
    """The edges of masks and the colours of images, by index of the view; one of them or both in each view.

    Where both show an edge, it is their mean, weighed by ``worth``: the variances, px^2, of both kinds by the view.
    """

    of_views: Mapping[int, tuple[MaskEvidence | ImageEvidence, ...]]
    worth: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    @property
    def views(self) -> tuple[int, ...]:
        """Indices of the views."""
        return tuple(self.of_views)

    def passes(self, config: TrackConfig) -> tuple[Pass, ...]:
        """Return what is done after each drawing of the outline: the passes of the view that has most of them.

        Those of a view are the colours' if these are used.
        """
        return max((sources[-1].passes(config) for sources in self.of_views.values()), key=len)

    def wider(self) -> Evidence:
        """Return the evidence for a search around the prediction, which may look for edges farther away."""
        of_views = {view: tuple(source.wider() for source in sources) for view, sources in self.of_views.items()}
        return replace(self, of_views=of_views)

    def distances(self, pixels: Float64, outline: DrawnOutline, reach: float) -> EdgeDistances:
        """Measure how far the points of an outline, now at ``pixels`` (N, 2), lie outside the edges in their views.

        The nearest edge within ``reach`` px along the normals counts that has the instrument on the inner side.
        """
        now = outline.split(pixels)
        return EdgeDistances.joined(
            [self._of_view(view, now[view], drawn, reach) for view, drawn in outline.by_view.items()]
        )

    def _of_view(self, view: int, pixels: Float64, outline: DrawnOutline, reach: float) -> EdgeDistances:
        """Return the distances of the points of an outline in one view."""
        first, *others = (source.distances(pixels, outline, reach) for source in self.of_views[view])
        own = self.worth.get(view, (OWN_VARIANCE, OWN_VARIANCE))
        return first.with_other(others[0], own) if others else first

    def unexplained(self, pixels: Float64, outline: DrawnOutline, reach: int) -> dict[int, float]:
        """Return by view the share of what its image shows of the instrument that is far from the outline.

        That is farther than ``reach`` px from it, whose points are now at ``pixels`` (N, 2). Of masks and colours, the
        smaller share counts.
        """
        now = outline.split(pixels)
        return {
            view: min(source.unexplained(now[view], drawn, reach) for source in self.of_views[view])
            for view, drawn in outline.by_view.items()
        }
