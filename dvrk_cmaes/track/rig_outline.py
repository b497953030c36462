"""The outline of a pose in all views of a rig, and the evidence about it, each view's points after another's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.evidence import EdgeDistances, OutlineEvidence, Pass
from dvrk_cmaes.track.outline_model import OutlineModel, Projected, Rim

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RigRim:
    """The points of a pose's outlines, N in all.

    ``views`` are the indices of the views that were drawn; ``parts`` has the outline of those of them in which enough
    of the instrument is seen, at least one. ``pose`` (4, 4), in the reference camera, and ``joints`` (J,) are those it
    was drawn at.
    """

    views: tuple[int, ...]
    parts: Mapping[int, Rim]
    pose: Float64
    joints: Float64

    @cached_property
    def lengths(self) -> Float64:
        """Outline that each point represents, px of its view, (N,)."""
        return _stacked([rim.lengths for rim in self.parts.values()])

    def split(self, values: NDArray[Any]) -> dict[int, NDArray[Any]]:
        """Return the values (N, ...) of the points by view."""
        ends = accumulate((len(rim.points) for rim in self.parts.values()), initial=0)
        return {view: values[begin:end] for view, (begin, end) in zip(self.parts, pairwise(ends), strict=True)}


class RigOutlines:
    """Draws the outlines of an instrument in the views of a rig; methods as those of `OutlineModel`.

    Poses are in the reference camera, pixels in the view of each point.
    """

    def __init__(self, body: Body, rig: Rig, points: int) -> None:
        self.rig = rig
        self.instrument = body.instrument
        self._models = [OutlineModel(body, view.camera, points) for view in rig.views]

    def draw(self, pose: Float64, joints: Float64, views: tuple[int, ...]) -> RigRim | None:
        """Find the outlines of a pose (4, 4) and joints (J,) in some views; None where too little is in any of them."""
        found = {view: self._models[view].draw(self._seen(view, pose), joints) for view in views}
        parts = {view: rim for view, rim in found.items() if rim is not None}
        return RigRim(views, parts, pose, joints) if parts else None

    def draw_anew(
        self, last: RigRim | None, pose: Float64, joints: Float64, tolerance: float, views: tuple[int, ...]
    ) -> RigRim | None:
        """Return the last outlines if root and joints have turned by at most ``tolerance`` rad since; else draw them.

        Those of other views than ``views`` are drawn, too.
        """
        if last is not None and last.views == views:
            view, rim = next(iter(last.parts.items()))
            if rim.turned(self._seen(view, pose), joints) <= tolerance:
                return last
        return self.draw(pose, joints, views)

    def place(self, rim: RigRim, pose: Float64, joints: Float64) -> Float64 | None:
        """Project the points at a pose (4, 4) and joints (J,), (N, 2); None if one is behind its camera."""
        placed = [self._models[view].place(part, self._seen(view, pose), joints) for view, part in rim.parts.items()]
        known = [pixels for pixels in placed if pixels is not None]
        return _stacked(known) if len(known) == len(placed) else None

    def project(self, rim: RigRim, pose: Float64, joints: Float64) -> Projected | None:
        """Project the points at a pose (4, 4) and joints (J,), with their Jacobian; None if one is behind its camera.

        The pose's small changes are in the root's axes, which all views have in common.
        """
        found = [self._models[view].project(part, self._seen(view, pose), joints) for view, part in rim.parts.items()]
        known = [one for one in found if one is not None]
        if len(known) < len(found):
            return None
        return Projected(_stacked([one.pixels for one in known]), _stacked([one.jacobian for one in known]))

    def _seen(self, view: int, pose: Float64) -> Float64:
        """Return a pose of the reference camera in a view's."""
        return np.asarray(self.rig.views[view].view_from_camera @ pose) if view else pose


@dataclass(frozen=True, eq=False)
class RigEvidence:
    """What the images of some views say about the outlines, by index of the view; methods as `OutlineEvidence`."""

    of_views: Mapping[int, OutlineEvidence]

    @property
    def views(self) -> tuple[int, ...]:
        """Indices of the views."""
        return tuple(self.of_views)

    def passes(self, config: TrackConfig) -> tuple[Pass, ...]:
        """Return what is done after each drawing: the passes of the view that has most of them."""
        return max((one.passes(config) for one in self.of_views.values()), key=len)

    def wider(self) -> RigEvidence:
        """Return the evidence for a search around the prediction."""
        return RigEvidence({view: one.wider() for view, one in self.of_views.items()})

    def distances(self, pixels: Float64, rim: RigRim, reach: float) -> EdgeDistances:
        """Measure how far the points, now at ``pixels`` (N, 2), lie outside the edges in their views."""
        at = rim.split(pixels)
        found = [self.of_views[view].distances(at[view], part, reach) for view, part in rim.parts.items()]
        if len(found) == 1:
            return found[0]
        return EdgeDistances(
            np.concatenate([one.distance for one in found]),
            np.concatenate([one.found for one in found]),
            np.concatenate([one.variance for one in found]),
        )

    def unexplained(self, pixels: Float64, rim: RigRim, reach: int) -> dict[int, float]:
        """Return by view the share of what its image shows that is farther than ``reach`` px from the outline."""
        at = rim.split(pixels)
        return {view: self.of_views[view].unexplained(at[view], part, reach) for view, part in rim.parts.items()}


def _stacked(parts: Sequence[Float64]) -> Float64:
    """Return arrays below each other."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
