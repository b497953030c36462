"""What a tracker sees of the images of a rig's views at one time: masks that are given, or found in the images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeVar, get_args
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig, View
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.frames.field_of_view import outside_view
from dvrk_cmaes.geometry import Bool, Image, Posed
from dvrk_cmaes.io.arguments import check_type, checked_mask
from dvrk_cmaes.pose.doubts import UNSUPPORTED, image_black, image_frozen, mask_says_nothing
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.pose.views import silhouette_of
from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.segmentation import GUESS, Box, Hints
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.colour_edges import EdgeAppearance, EdgeFit, ImageEvidence, fit_edges, learned
from dvrk_cmaes.track.histogram_ratio import ColourModel
from dvrk_cmaes.track.image_masks import SPREAD_OF_FIT, learned_colours, mask_around
from dvrk_cmaes.track.outlines import OutlineModel

Mask = Bool


class ImageCheck:
    """Checks the images of one camera; ``black_level`` is the brightest pixel below which an image counts as black."""

    def __init__(self, camera: Camera, black_level: int) -> None:
        self.size = (camera.height, camera.width)
        self._black_level = black_level
        self.last: int | None = None
        """Checksum of the latest mask; None without one."""

    def check_size(self, name: str, array: Bool | NDArray[np.uint8] | None) -> None:
        """Raise an InputError for an array that is not of the camera's size, or for an image that is not (H, W, 3)."""
        if array is None:
            return
        if name == "image" and (
            array.dtype != np.uint8 or array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,))
        ):
            raise InputError(f"image: expected (H, W, 3) uint8, BGR, got {array.dtype} of shape {array.shape}")
        if array.shape[:2] != self.size:
            raise InputError(
                f"{name}: expected {self.size[1]} x {self.size[0]} pixels as the camera has, got an array of shape "
                f"{array.shape}"
            )

    def problem(
        self, mask: Mask | None, image: NDArray[np.uint8] | None, ignore: Mask | None, *, by_image: bool
    ) -> str | None:
        """Return why an image says nothing about the pose; None if it may. ``by_image``: its colours are used."""
        brightest = self._black_level if image is None else int(image.max())
        black = image_black(brightest, self._black_level)
        if black is not None or by_image:
            return black
        if mask is None:
            return mask_says_nothing(given=False, shown=False, surrounded=False)
        counts = np.ones_like(mask) if ignore is None else ~ignore
        return mask_says_nothing(given=True, shown=bool((mask & counts).any()), surrounded=bool((~mask & counts).any()))

    def is_same(self, array: Mask | NDArray[np.uint8] | None) -> bool:
        """Whether a mask or an image is that of the call before; of an image, every fourth row is compared."""
        if array is None:
            seen = None
        else:
            seen = crc32(np.packbits(array).tobytes() if array.dtype == np.bool_ else array[::4].tobytes())
        before, self.last = self.last, seen
        return array is not None and self.last == before


A = TypeVar("A", bound=NDArray[Any])
Masks = Mask | Mapping[str, Mask | None] | Sequence[Mask | None]
"""The mask (H, W) of a camera, or those of a rig's views: by name, or in the rig's order; None for a missing one."""
Images = Image | Mapping[str, Image | None] | Sequence[Image | None]
"""The same of images (H, W, 3)."""
EvidenceKind = Literal["masks", "images"]
KINDS: Final[tuple[EvidenceKind, ...]] = get_args(EvidenceKind)

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
            image_frozen("image" if mask is None else "mask", same) if problem is None else problem
            for mask, problem, same in zip(self.masks, self.problems, self.same, strict=True)
        ]
        return replace(self, problems=tuple(problems))


_Look = tuple[ColourModel, EdgeAppearance]
"""How the instrument and its surroundings look in a view: colours on the whole, and along the outline."""


class ViewSegmenter:
    """Turns the arrays of the views' images into masks, and keeps how the instrument looks in them.

    ``kind`` is the evidence that is used; None for the mask of an image that has one, and else its colours. ``hints``
    state where the instrument is in the first image of the first view, if that is segmented.

    Raises
    ------
    InputError
        Another kind of evidence.
    """

    def __init__(
        self, rig: Rig, body: Body, config: TrackConfig, kind: EvidenceKind | None, hints: Hints | None
    ) -> None:
        if kind is not None and kind not in KINDS:
            raise InputError(f"evidence: expected one of {', '.join(nearest_first(str(kind), KINDS))}, got {kind!r}")
        self._names, self._body = rig.names, body
        self._checks = [ImageCheck(view.camera, config.black_level) for view in rig.views]
        self._looks: list[_Look | None] = [None] * len(rig.views)
        self._outlines = OutlineModel(body, rig, config.points)
        self._colour_share = config.colour_share
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

    def is_ready(self, seen: Seen) -> bool:
        """Whether the images have masks, or show nothing, or masks can be found in them by colours that are known."""
        if not seen.clear:
            return True
        return any(seen.masks[view] is not None or self._looks[view] is not None for view in seen.clear)

    def given(self, seen: Seen) -> dict[str, Mask]:
        """Return the masks of the clear views by name, of those that are given and used."""
        return {self._names[view]: mask for view in seen.clear if (mask := seen.masks[view]) is not None}

    def fit(self, seen: Seen, start: Posed, expected: Expected, *, near: bool) -> EdgeFit | None:
        """Fit a pose to the edges of the clear images, whose colours are known; None without any.

        Where the start is not as ``near`` as an image before tells, or the edges there do not support the pose, they
        are looked for farther away.
        """
        images = {
            view: ImageEvidence(image, look[1], seen.ignored[view])
            for view in seen.clear
            if (image := seen.images[view]) is not None and (look := self._looks[view]) is not None
        }
        if not images:
            return None
        found = fit_edges(self._outlines, images, start, expected, far=not near)
        if near and (found is None or found.doubts):
            far = fit_edges(self._outlines, images, start, expected, far=True)
            if far is not None and (found is None or far.net_support > found.net_support):
                return far
        return found

    def masks_at(self, seen: Seen, views: Sequence[View], at: Posed) -> dict[str, Mask]:
        """Find masks in the clear images about a pose that they support; those of views that show it without doubt."""
        masks = {}
        for view in seen.clear:
            image, look, ignored = seen.images[view], self._looks[view], seen.ignored[view]
            if image is None or look is None:
                continue
            outside = outside_view(image)
            if ignored is not None:
                outside = outside | ignored
            silhouette = silhouette_of(at, views[view], self._body)
            found = mask_around(image, silhouette, look[0], outside, SPREAD_OF_FIT, passes=1)
            if found is not None and found.unsupported <= UNSUPPORTED:
                masks[self._names[view]] = found.mask
        return masks

    def first_masks(self, seen: Seen, *, hinted: bool, around: Mapping[int, Box]) -> dict[str, Mask]:
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
            image = seen.images[view]
            if image is None:
                continue
            found = segment(image, **vars(hints))
            if found.mask.any() and (hinted or found.confidence >= GUESS):  # with its own hints it is no guess
                return {self._names[view]: found.mask}
        return {}

    def ignored(self, seen: Seen) -> dict[str, Mask]:
        """Return the ignored pixels by name of the view."""
        return {name: ignored for name, ignored in zip(self._names, seen.ignored, strict=True) if ignored is not None}

    def learn(self, seen: Seen, views: Sequence[View], at: Posed) -> None:
        """Learn how the instrument, of a pose that is trusted, looks in the images."""
        for view in seen.clear:
            image, ignored, before = seen.images[view], seen.ignored[view], self._looks[view]
            if image is None:
                continue
            drawn = self._outlines.draw(at, view)
            colours = learned_colours(image, silhouette_of(at, views[view], self._body), ignored)
            if drawn is None or colours is None:
                continue
            along, share = learned(image, drawn.pixels, drawn, ignored), self._colour_share
            if before is not None:
                colours, along = before[0].mixed(colours, share), before[1].mixed(along, share)
            self._looks[view] = colours, along

    def boxes_around(self, at: Posed, views: Sequence[View]) -> dict[int, Box]:
        """Return a box around the silhouette of a pose in each view that shows it, with a margin."""
        boxes = {}
        for number, view in enumerate(views):
            rows, columns = np.nonzero(silhouette_of(at, view, self._body))
            if len(rows):
                height, width = self._checks[number].size
                low = np.maximum(np.array([columns.min(), rows.min()]) - _MARGIN * width, 0)
                high = np.minimum(np.array([columns.max(), rows.max()]) + _MARGIN * width, [width - 1, height - 1])
                boxes[number] = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        return boxes
