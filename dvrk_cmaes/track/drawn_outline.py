"""The outlines of an instrument as they were drawn in the views of a rig, by points that are fixed on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Float32, Float64, Indices, Posed
from dvrk_cmaes.track.clearance import clearance_of


@dataclass(frozen=True, eq=False)
class DrawnOutline:
    """N points on the outlines of an instrument, fixed on it, each view's after another's.

    link : (N,) index of the link. points : (N, 3) m, in the link's frame. normals : (N, 2) unit vectors in the image,
    out of the silhouette. lengths : (N,) px of outline that each represents. pixels : (N, 2) where they were drawn.

    ``views`` are the indices of the views that were drawn, ``at`` where the instrument was then, in the reference
    camera. ``parts`` are the points of each of those views in which enough of the instrument is seen, at least one.
    """

    views: tuple[int, ...]
    at: Posed
    parts: Mapping[int, slice]
    link: Indices
    points: Float64
    normals: Float64
    lengths: Float64
    pixels: Float64

    @staticmethod
    def joined(views: tuple[int, ...], drawn: Sequence[DrawnOutline]) -> DrawnOutline:
        """Return the outlines that were ``drawn`` in single views as one; ``views`` are all that were to be drawn."""
        ends = list(accumulate((len(outline.points) for outline in drawn), initial=0))
        parts = {outline.views[0]: slice(*pair) for outline, pair in zip(drawn, pairwise(ends), strict=True)}
        arrays = [outline._arrays(slice(None)) for outline in drawn]
        of_all: dict[str, Any] = {name: np.concatenate([own[name] for own in arrays]) for name in arrays[0]}
        return replace(drawn[0], views=views, parts=parts, **of_all)

    def _arrays(self, part: slice) -> dict[str, Any]:
        """Return the arrays of a part of the points, by name."""
        return {name: getattr(self, name)[part] for name in ("link", "points", "normals", "lengths", "pixels")}

    @cached_property
    def by_view(self) -> dict[int, DrawnOutline]:
        """The outline in each view, by itself."""
        return {
            view: replace(self, views=(view,), parts={view: slice(None)}, **self._arrays(part))
            for view, part in self.parts.items()
        }

    @cached_property
    def clearance(self) -> Float32:
        """Lengths (2, N), px, of lines along the normals of an outline in one view, in the silhouette and beside it."""
        return clearance_of(self.pixels, self.normals)

    def split(self, values: NDArray[Any]) -> dict[int, NDArray[Any]]:
        """Return values (N, ...) of the points by view."""
        return {view: values[part] for view, part in self.parts.items()}
