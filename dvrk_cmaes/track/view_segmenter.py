"""What a tracker sees of the images of a rig's views at one time: masks that are given, or found in the images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig, View
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.frames.field_of_view import outside_view
from dvrk_cmaes.frames.seen_view import SeenView, seen_by
from dvrk_cmaes.geometry import Bool, Image, Posed
from dvrk_cmaes.io.arguments import check_type, checked_mask
from dvrk_cmaes.pose.doubts import image_black, image_frozen, mask_says_nothing
from dvrk_cmaes.pose.views import silhouette_of
from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.segmentation import GUESS
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.image_masks import ColourModel, learned_colours

Mask = Bool


Masks = Mask | Mapping[str, Mask | None] | Sequence[Mask | None]
"""The mask (H, W) of a camera, or those of a rig's views: by name, or in the rig's order; None for a missing one."""
Images = Image | Mapping[str, Image | None] | Sequence[Image | None]
"""The same of images (H, W, 3)."""


@dataclass(frozen=True, eq=False)
class SeenImage:
    """The arrays of one view that are used, None where there is none.

    ``problem`` is why they say nothing about the pose, None if they may; ``same`` whether they are those of the time
    before.
    """

    mask: Mask | None
    image: Image | None
    ignore: Mask | None
    problem: str | None
    same: bool


@dataclass(frozen=True, eq=False)
class Seen:
    """What is seen at one time, in the order of the rig's views."""

    views: tuple[SeenImage, ...]

    @property
    def clear(self) -> tuple[tuple[int, SeenImage], ...]:
        """The views without a problem, with their indices."""
        return tuple((number, view) for number, view in enumerate(self.views) if view.problem is None)

    @property
    def main(self) -> SeenImage:
        """The view that messages are about: the first without a problem, or with a mask, or else the first."""
        with_mask = (view for view in self.views if view.mask is not None)
        return next(iter((*(view for _, view in self.clear), *with_mask, self.views[0])))

    @property
    def problem(self) -> str | None:
        """Why no view says anything about the pose; None if one may."""
        return self.main.problem

    @property
    def source(self) -> str:
        """What the evidence is taken from, for messages."""
        return "mask" if any(view.mask is not None for view in (self.main, *dict(self.clear).values())) else "image"

    @property
    def any_same(self) -> bool:
        """Whether the image of a view without a problem is that of the time before."""
        return any(view.same for _, view in self.clear)

    def without_frozen(self) -> Seen:
        """Return the same with a problem of each view whose image is that of the time before although the arm moved."""
        frozen = (image_frozen("image" if view.mask is None else "mask", view.same) for view in self.views)
        pairs = zip(self.views, frozen, strict=True)
        return Seen(tuple(replace(view, problem=view.problem or problem) for view, problem in pairs))


_Look = tuple[ColourModel, Bool]
"""The colours of the instrument and its surroundings in a view, and the pixels (H, W) outside the field of view."""


class ViewSegmenter:
    """Turns the arrays of the views' images into masks, and keeps how the instrument looks in them.

    The mask of an image that has one is used, and else its colours.
    """

    def __init__(self, rig: Rig, body: Body, config: TrackConfig) -> None:
        self._rig, self._names, self._body = rig, rig.names, body
        self._last: list[int | None] = [None] * len(rig.views)  # checksums of the latest masks or images, None without
        self._looks: list[_Look | None] = [None] * len(rig.views)
        self._black_level = config.black_level  # value of the brightest pixel, below which an image counts as black
        self._colour_share = config.colour_share

    def look(self, mask: Masks | None, image: Images | None, ignore: Masks | None) -> Seen:
        """Check the arrays of all views, and choose those that are used; InputError for wrong sizes, names, numbers."""
        arguments = (("mask", mask), ("image", image), ("ignore", ignore))
        arrays = zip(*(self._by_view(name, value) for name, value in arguments), strict=True)
        return Seen(tuple(self._looked(number, *of_view) for number, of_view in enumerate(arrays)))

    def _looked(self, number: int, mask: Mask | None, image: Image | None, ignore: Mask | None) -> SeenImage:
        """Check the arrays of one view, and choose those that are used."""
        mask = None if mask is None else checked_mask("mask", mask)
        ignore = None if ignore is None else checked_mask("ignore", ignore)
        for name, array in (("mask", mask), ("ignore", ignore), ("image", image)):
            if array is not None:
                _check_size(name, array, self._rig.views[number].camera)
        used_image = None if image is not None and image.ndim == 2 else image
        before, now = self._last[number], None
        if mask is not None:
            now = crc32(np.packbits(mask).tobytes())
        elif used_image is not None:
            now = crc32(used_image[::4].tobytes())
        self._last[number] = now
        problem = image_black(self._black_level if image is None else int(image.max()), self._black_level)
        if problem is None and mask is not None:
            counts = np.ones_like(mask) if ignore is None else ~ignore
            shown, surrounded = bool((mask & counts).any()), bool((~mask & counts).any())
            problem = mask_says_nothing(given=True, shown=shown, surrounded=surrounded)
        elif problem is None and used_image is None:
            problem = mask_says_nothing(given=False, shown=False, surrounded=False)
        return SeenImage(mask, used_image, ignore, problem, now is not None and now == before)

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
        return any(view.mask is not None or self._looks[number] is not None for number, view in seen.clear)

    def given(self, seen: Seen) -> dict[str, Mask]:
        """Return the masks of the clear views by name, of those that are given and used."""
        return {self._names[number]: view.mask for number, view in seen.clear if view.mask is not None}

    @property
    def colours(self) -> dict[str, ColourModel]:
        """The colours that were learned, by view."""
        return {name: look[0] for name, look in zip(self._names, self._looks, strict=True) if look is not None}

    def views(self, seen: Seen) -> tuple[SeenView, ...]:
        """Return the views as they were seen: with the mask that is given, or the image in which one can be found."""
        views = []
        clear = dict(seen.clear)
        for number, (view, own) in enumerate(zip(self._rig.views, seen.views, strict=True)):
            look, used = self._looks[number], clear.get(number)
            mask, image = (None, None) if used is None else (used.mask, used.image)
            shown = seen_by(view, mask, ignore=own.ignore, image=image if mask is None and look is not None else None)
            views.append(shown if look is None or shown.image is None else shown.without(look[1]))
        return tuple(views)

    def first_masks(self, seen: Seen, *, guesses: bool) -> dict[str, Mask]:
        """Return the masks by name of the view: those given, or that of the first image in which one is found.

        One that is only guessed counts if ``guesses`` do.
        """
        given = {name: of.mask for name, of in zip(self._names, seen.views, strict=True) if of.mask is not None}
        if given:
            return given
        for number, view in seen.clear:
            if view.image is None:
                continue
            found = segment(view.image)
            if found.mask.any() and (guesses or found.confidence >= GUESS):
                return {self._names[number]: found.mask}
        return {}

    def ignored(self, seen: Seen) -> dict[str, Mask]:
        """Return the ignored pixels by name of the view."""
        return {name: of.ignore for name, of in zip(self._names, seen.views, strict=True) if of.ignore is not None}

    def learn(self, seen: Seen, views: Sequence[View], at: Posed) -> None:
        """Learn how the instrument, of a pose that is trusted, looks in the images."""
        for number, view in seen.clear:
            if view.image is None:
                continue
            colours = learned_colours(view.image, silhouette_of(at, views[number], self._body), view.ignore)
            if colours is not None:
                before = self._looks[number]
                colours = colours if before is None else before[0].mixed(colours, self._colour_share)
                self._looks[number] = colours, outside_view(view.image)


def _check_size(name: str, array: NDArray[Any], camera: Camera) -> None:
    """Raise an InputError for an array that is not of the camera's size, or for an image that is not (H, W, 3)."""
    if name == "image" and (array.dtype != np.uint8 or array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,))):
        raise InputError(f"image: expected (H, W, 3) uint8, BGR, got {array.dtype} of shape {array.shape}")
    if array.shape[:2] != (camera.height, camera.width):
        raise InputError(
            f"{name}: expected {camera.width} x {camera.height} pixels as the camera has, got an array of shape "
            f"{array.shape}"
        )
