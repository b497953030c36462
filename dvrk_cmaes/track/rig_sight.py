"""What a tracker sees of the images of a rig's views at one time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.segment.segmentation import Box, Hints
from dvrk_cmaes.track.images import FROZEN, Mask
from dvrk_cmaes.track.outline_model import Rim
from dvrk_cmaes.track.rig_outline import RigEvidence, RigRim
from dvrk_cmaes.track.sight import EvidenceKind, Image, Seen, Sight

Float64 = NDArray[np.float64]

Masks = Mask | Mapping[str, Mask | None] | Sequence[Mask | None]
"""The mask (H, W) of a camera, or those of a rig's views: by name, or in the rig's order; None for a missing one."""
Images = Image | Mapping[str, Image | None] | Sequence[Image | None]
"""The same of images (H, W, 3)."""


@dataclass(frozen=True, eq=False)
class RigSeen:
    """What is seen in each view, in the rig's order; a view with a problem says nothing about the pose."""

    of_views: tuple[Seen, ...]

    @property
    def clear(self) -> dict[int, Seen]:
        """The views without a problem, by index."""
        return {view: seen for view, seen in enumerate(self.of_views) if seen.problem is None}

    @property
    def main(self) -> Seen:
        """The view that messages are about: the first without a problem, or with a mask, or else the first."""
        with_mask = [seen for seen in self.of_views if seen.mask is not None]
        return next(iter((*self.clear.values(), *with_mask, *self.of_views)))

    @property
    def problem(self) -> str | None:
        """Why no view says anything about the pose; None if one may."""
        return self.main.problem

    @property
    def source(self) -> str:
        """What the evidence is taken from, for messages."""
        return "mask" if any(seen.mask is not None for seen in self.clear.values()) else self.main.source

    @property
    def any_same(self) -> bool:
        """Whether the image of a view without a problem is that of the time before."""
        return any(seen.same for seen in self.clear.values())

    def without_frozen(self) -> RigSeen:
        """Return the views, with a problem for each whose image is that of the time before although the arm moved."""
        frozen = [
            replace(seen, problem=FROZEN.format(source=seen.source)) if seen.problem is None and seen.same else seen
            for seen in self.of_views
        ]
        return RigSeen(tuple(frozen))


class RigSight:
    """Turns the arrays of a rig's images into evidence; a `Sight` for each view.

    ``kind`` and ``hints`` are as those of `Sight`; the hints are about the first view.
    """

    def __init__(self, rig: Rig, config: TrackConfig, kind: EvidenceKind | None, hints: Hints | None) -> None:
        self._names = rig.names
        self._sights = [
            Sight(view.camera, config, kind, None if number else hints) for number, view in enumerate(rig.views)
        ]

    def look(self, mask: Masks | None, image: Images | None, ignore: Masks | None) -> RigSeen:
        """Check the arrays of all views, and choose those that are used; InputError for wrong sizes, names, numbers."""
        given = zip(
            *(self._by_view(*one) for one in (("mask", mask), ("image", image), ("ignore", ignore))), strict=True
        )
        return RigSeen(tuple(sight.look(*arrays) for sight, arrays in zip(self._sights, given, strict=True)))

    def _by_view(self, name: str, value: Masks | Images | None) -> list[Any]:
        """Return an argument's arrays in the order of the views."""
        if isinstance(value, Mapping):
            for key in value:
                if key not in self._names:
                    named = ", ".join(nearest_first(str(key), self._names))
                    raise InputError(f"{name}: expected views {named}, got {key!r}")
            return [value.get(view) for view in self._names]
        if value is None:
            return [None] * len(self._names)
        arrays = [value] if isinstance(value, np.ndarray) else list(value)
        if len(arrays) != len(self._names):
            raise InputError(f"{name}: expected one by view ({', '.join(self._names)}), got {len(arrays)}")
        return arrays

    def evidence(self, seen: RigSeen) -> RigEvidence | None:
        """Return the evidence of the images; None without masks, if colours and masks are found in none of them.

        An image without mask or learned colours is segmented only where no other view tells anything.
        """
        clear = seen.clear
        ready = {view: one for view, one in clear.items() if self._sights[view].is_ready(one)}
        found = {view: self._sights[view].evidence(one) for view, one in (ready or clear).items()}
        known = {view: evidence for view, evidence in found.items() if evidence is not None}
        return RigEvidence(known) if known else None

    def masks(self, seen: RigSeen, *, hinted: bool, around: Mapping[int, Box]) -> dict[str, Mask]:
        """Return the masks by name of the view: those given, or that of the first image in which one is found.

        ``hinted`` and ``around``, by view, are as in `Sight.mask`.
        """
        given = {name: one.given for name, one in zip(self._names, seen.of_views, strict=True) if one.given is not None}
        if given:
            return given
        for view, one in seen.clear.items():
            mask = self._sights[view].mask(one, hinted=hinted, around=around.get(view))
            if mask is not None:
                return {self._names[view]: mask}
        return {}

    def ignored(self, seen: RigSeen) -> dict[str, Mask]:
        """Return the ignored pixels by name of the view."""
        by_view = zip(self._names, seen.of_views, strict=True)
        return {name: one.ignore for name, one in by_view if one.ignore is not None}

    def learn(self, seen: RigSeen, outlines: Mapping[int, tuple[Rim, Float64]], *, anew: bool) -> None:
        """Learn the colours of the images along outlines, by view, with their points (N, 2)."""
        for view, (rim, pixels) in outlines.items():
            self._sights[view].learn(seen.of_views[view], pixels, rim, anew=anew)

    def boxes_of(self, rim: RigRim) -> dict[int, Box]:
        """Return a box around the outline in each view with a margin."""
        return {view: self._sights[view].box_of(part) for view, part in rim.parts.items()}

    def checkpoint(self) -> list[dict[str, Any]]:
        """Return what is kept of the images so far as plain values."""
        return [sight.checkpoint() for sight in self._sights]

    def restore(self, saved: Sequence[dict[str, Any]]) -> None:
        """Go on from the values of `checkpoint`; KeyError, TypeError or ValueError if they are not those."""
        for sight, one in zip(self._sights, saved, strict=True):
            sight.restore(one)
