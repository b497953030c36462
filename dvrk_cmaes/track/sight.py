"""What a tracker sees of the images of a rig's views at one time: evidence, and masks to solve them by themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.arguments import check_type, checked_mask
from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.confidence import GUESS
from dvrk_cmaes.segment.segmentation import Box, Hints
from dvrk_cmaes.track.appearance import Appearance
from dvrk_cmaes.track.drawn_outline import DrawnOutline
from dvrk_cmaes.track.edges import OWN_VARIANCE
from dvrk_cmaes.track.evidence import Evidence
from dvrk_cmaes.track.image_evidence import ImageEvidence, learned
from dvrk_cmaes.track.images import FROZEN, ImageCheck, Mask
from dvrk_cmaes.track.mask_evidence import MaskEvidence

A = TypeVar("A", bound=NDArray[Any])
Float64 = NDArray[np.float64]
Image = NDArray[np.uint8]
Masks = Mask | Mapping[str, Mask | None] | Sequence[Mask | None]
"""The mask (H, W) of a camera, or those of a rig's views: by name, or in the rig's order; None for a missing one."""
Images = Image | Mapping[str, Image | None] | Sequence[Image | None]
"""The same of images (H, W, 3)."""
EvidenceKind = Literal["masks", "images", "both"]
KINDS: Final[tuple[EvidenceKind, ...]] = get_args(EvidenceKind)

_WORTH_RANGE = (0.05, 9.0)  # px^2, bounds of the variance of one kind of edges
_MARGIN = 0.04  # of the image's width, around an expected silhouette


@dataclass(frozen=True, eq=False)
class Seen:
    """The arrays of one time that are used, each a tuple of V, in the order of the rig's views.

    ``masks``, ``images`` and ``ignored`` are None where there is none. ``problems`` is why a view says nothing about
    the pose, None if it may; ``same`` whether its image is that of the time before. ``given`` are the masks that were
    given, even where masks are not evidence: images that are solved by themselves are solved by them.
    """

    masks: tuple[Mask | None, ...]
    images: tuple[Image | None, ...]
    ignored: tuple[Mask | None, ...]
    problems: tuple[str | None, ...]
    same: tuple[bool, ...]
    given: tuple[Mask | None, ...]

    @property
    def clear(self) -> tuple[int, ...]:
        """Indices of the views without a problem."""
        return tuple(view for view, problem in enumerate(self.problems) if problem is None)

    @property
    def main(self) -> int:
        """The view that messages are about: the first without a problem, or with a mask, or else the first."""
        with_mask = (view for view, mask in enumerate(self.masks) if mask is not None)
        return next(iter((*self.clear, *with_mask, 0)))

    @property
    def problem(self) -> str | None:
        """Why no view says anything about the pose; None if one may."""
        return self.problems[self.main]

    @property
    def source(self) -> str:
        """What the evidence is taken from, for messages."""
        return "mask" if any(self.masks[view] is not None for view in (*self.clear, self.main)) else "image"

    @property
    def any_same(self) -> bool:
        """Whether the image of a view without a problem is that of the time before."""
        return any(self.same[view] for view in self.clear)

    def copied(self) -> Seen:
        """Return the same with arrays of its own, which the caller of the tracker does not change."""

        def own(arrays: tuple[A | None, ...]) -> tuple[A | None, ...]:
            return tuple(None if array is None else array.copy() for array in arrays)

        masks = own(self.masks)
        given = masks if self.given is self.masks else own(self.given)
        return replace(self, masks=masks, images=own(self.images), ignored=own(self.ignored), given=given)

    def without_frozen(self) -> Seen:
        """Return the same with a problem of each view whose image is that of the time before although the arm moved."""
        problems = [
            FROZEN.format(source="image" if mask is None else "mask") if problem is None and same else problem
            for mask, problem, same in zip(self.masks, self.problems, self.same, strict=True)
        ]
        return replace(self, problems=tuple(problems))


class Sight:
    """Turns the arrays of the views' images into evidence, and keeps how the instrument looks in them.

    ``kind`` is the evidence that is used; None for the mask of an image that has one, and else its colours. ``hints``
    state where the instrument is in the first image of the first view, if that is segmented.

    Raises
    ------
    InputError
        Another kind of evidence.
    """

    def __init__(self, rig: Rig, config: TrackConfig, kind: EvidenceKind | None, hints: Hints | None) -> None:
        if kind is not None and kind not in KINDS:
            raise InputError(f"evidence: expected one of {', '.join(nearest_first(str(kind), KINDS))}, got {kind!r}")
        self._names = rig.names
        self._checks = [ImageCheck(view.camera, config.black_level) for view in rig.views]
        self._appearances: list[Appearance | None] = [None] * len(rig.views)
        self._colour_share = config.colour_share
        self._reach = config.reach_px
        self._worth = [(OWN_VARIANCE, OWN_VARIANCE)] * len(rig.views)
        self._kind = kind
        self._hints = hints or Hints()

    def look(self, mask: Masks | None, image: Images | None, ignore: Masks | None) -> Seen:
        """Check the arrays of all views, and choose those that are used; InputError for wrong sizes, names, numbers."""
        arguments = (("mask", mask), ("image", image), ("ignore", ignore))
        arrays = zip(*(self._by_view(name, value) for name, value in arguments), strict=True)
        views = [self._look_at(check, *of_view) for check, of_view in zip(self._checks, arrays, strict=True)]
        return Seen(*zip(*views, strict=True))

    def _look_at(
        self, check: ImageCheck, mask: Mask | None, image: Image | None, ignore: Mask | None
    ) -> tuple[Mask | None, Image | None, Mask | None, str | None, bool, Mask | None]:
        """Check the arrays of one view, and return what `Seen` has of it."""
        mask = None if mask is None else checked_mask("mask", mask)
        ignore = None if ignore is None else checked_mask("ignore", ignore)
        for name, array in (("mask", mask), ("ignore", ignore), ("image", image)):
            check.check_size(name, array)
        used_mask = None if self._kind == "images" else mask
        used_image = None if self._kind == "masks" or (image is not None and image.ndim == 2) else image
        by_image = used_mask is None and used_image is not None
        problem = check.problem(used_mask, image, ignore, by_image=by_image)
        same = check.is_same(used_image if by_image else used_mask)
        return used_mask, used_image, ignore, problem, same, mask

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
        check_type(name, value, (np.ndarray, list, tuple), "an array (H, W), or those of the views")
        arrays = [value] if isinstance(value, np.ndarray) else list(value)
        if len(arrays) != len(self._names):
            raise InputError(f"{name}: expected one by view ({', '.join(self._names)}), got {len(arrays)}")
        return arrays

    def evidence(self, seen: Seen) -> Evidence | None:
        """Return the evidence of the images; None without masks, if colours and masks are found in none of them.

        An image without mask or learned colours is segmented only where no other view tells anything.
        """
        ready = [view for view in seen.clear if self._is_ready(seen, view)]
        of_views = {view: sources for view in ready or seen.clear if (sources := self._sources(seen, view))}
        return Evidence(of_views, dict(enumerate(self._worth))) if of_views else None

    def _is_ready(self, seen: Seen, view: int) -> bool:
        """Whether a view's image has evidence without being segmented."""
        return seen.masks[view] is not None or (seen.images[view] is not None and self._appearances[view] is not None)

    def _sources(self, seen: Seen, view: int) -> tuple[MaskEvidence | ImageEvidence, ...]:
        """Return the evidence of a view; none if it has no mask, and neither colours nor a mask are found in it."""
        mask, image, ignored, known = seen.masks[view], seen.images[view], seen.ignored[view], self._appearances[view]
        if mask is None and known is None:
            mask = self._mask(seen, view, Hints(), hinted=False)
        sources: list[MaskEvidence | ImageEvidence] = [] if mask is None else [MaskEvidence(mask, ignored)]
        if image is not None and known is not None and (mask is None or self._kind == "both"):
            sources.append(ImageEvidence(image, known, ignored))
        return tuple(sources)

    def _mask(self, seen: Seen, view: int, hints: Hints, *, hinted: bool) -> Mask | None:
        """Return the mask of a view, found by its colours if none was given; None if nothing is found, or a guess.

        The ``hints`` hold for the image; if they are its own, ``hinted``, what is found is not a guess.
        """
        image = seen.images[view]
        if seen.given[view] is not None or image is None:
            return seen.given[view]
        segmentation = segment(image, box=hints.box, points=hints.points, not_points=hints.not_points)
        sure = hinted or segmentation.confidence >= GUESS
        return segmentation.mask if segmentation.mask.any() and sure else None

    def masks(self, seen: Seen, *, hinted: bool, around: Mapping[int, Box]) -> dict[str, Mask]:
        """Return the masks by name of the view: those given, or that of the first image in which one is found.

        If the images are ``hinted``, the hints hold for that of the first view. ``around``, by view, are boxes that
        hold the instrument where there are none.
        """
        given = {name: mask for name, mask in zip(self._names, seen.given, strict=True) if mask is not None}
        if given:
            return given
        for view in seen.clear:
            hints = self._hints if hinted and view == 0 else Hints()
            if hints == Hints() and view in around:
                hints = Hints(box=around[view])
            mask = self._mask(seen, view, hints, hinted=hinted)
            if mask is not None:
                return {self._names[view]: mask}
        return {}

    def ignored(self, seen: Seen) -> dict[str, Mask]:
        """Return the ignored pixels by name of the view."""
        return {name: ignored for name, ignored in zip(self._names, seen.ignored, strict=True) if ignored is not None}

    def learn(self, seen: Seen, outline: DrawnOutline, pixels: Float64, *, anew: bool) -> None:
        """Learn how the instrument looks along an outline whose points are at ``pixels`` (N, 2) of their views.

        ``anew`` forgets what was learned before.
        """
        now = outline.split(pixels)
        for view, drawn in outline.by_view.items():
            image, before = seen.images[view], self._appearances[view]
            if image is not None:
                latest = learned(image, now[view], drawn, seen.ignored[view])
                mixed = latest if anew or before is None else before.mixed(latest, self._colour_share)
                self._appearances[view] = mixed

    def judge(self, evidence: Evidence, outline: DrawnOutline, pixels: Float64) -> None:
        """Learn in views with two kinds of edges how far each lie from a predicted outline, at ``pixels`` (N, 2)."""
        now, share = outline.split(pixels), self._colour_share
        for view, drawn in outline.by_view.items():
            sources = evidence.of_views[view]
            if len(sources) < len(self._worth[view]):
                continue
            latest = [source.distances(now[view], drawn, self._reach).robust_variance for source in sources]
            mask, image = (
                before if found is None else (1 - share) * before + share * float(np.clip(found, *_WORTH_RANGE))
                for before, found in zip(self._worth[view], latest, strict=True)
            )
            self._worth[view] = (mask, image)

    def boxes_of(self, outline: DrawnOutline) -> dict[int, Box]:
        """Return a box around the outline in each view with a margin."""
        boxes = {}
        for view, pixels in outline.all_pixels.items():
            height, width = self._checks[view].size
            margin, high = _MARGIN * width, np.array([width, height]) - 1
            left, top = np.maximum(pixels.min(axis=0) - margin, 0).tolist()
            right, bottom = np.minimum(pixels.max(axis=0) + margin, high).tolist()
            boxes[view] = (left, top, right, bottom)
        return boxes

    def checkpoint(self) -> list[dict[str, Any]]:
        """Return what is kept of the images of each view so far as plain values."""
        return [
            {"last": check.last, "appearance": None if known is None else known.checkpoint(), "worth": list(worth)}
            for check, known, worth in zip(self._checks, self._appearances, self._worth, strict=True)
        ]

    def restore(self, saved: Sequence[Mapping[str, Any]]) -> None:
        """Go on from the values of `checkpoint`; KeyError, TypeError or ValueError if they are not those."""
        for view, (check, values) in enumerate(zip(self._checks, saved, strict=True)):
            last, known = values["last"], values["appearance"]
            check.last = None if last is None else int(last)
            mask, image = (float(variance) for variance in values["worth"])
            self._worth[view] = (mask, image)
            self._appearances[view] = None if known is None else Appearance.restored(known)
