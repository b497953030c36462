"""What a tracker sees of the images of a rig's views at one time: masks that are given, or found in the images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig, View
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.field_of_view import outside_view
from dvrk_cmaes.frames.seen_view import SeenView, by_view
from dvrk_cmaes.geometry import Bool, Image, Posed
from dvrk_cmaes.io.arguments import check_type
from dvrk_cmaes.pose.doubts import image_black, image_frozen, mask_says_nothing
from dvrk_cmaes.pose.views import silhouette_of
from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.segmentation import GUESS
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.image_masks import ColourModel, learned_colours

Masks = Bool | Mapping[str, Bool | None] | Sequence[Bool | None]
"""The mask (H, W) of a camera, or those of a rig's views: by name, or in the rig's order; None for a missing one."""
Images = Image | Mapping[str, Image | None] | Sequence[Image | None]
"""The same of images (H, W, 3)."""


@dataclass(frozen=True, eq=False)
class SeenImage(SeenView):
    """A view with the arrays of one time that are used.

    ``problem`` is why they say nothing about the pose, None if they may; ``same`` whether they are those of the time
    before.
    """

    problem: str | None = None
    same: bool = False


@dataclass(frozen=True, eq=False)
class Seen:
    """What is seen at one time, in the order of the rig's views."""

    views: tuple[SeenImage, ...]

    @property
    def clear(self) -> tuple[SeenImage, ...]:
        """The views without a problem."""
        return tuple(view for view in self.views if view.problem is None)

    @property
    def main(self) -> SeenImage:
        """The view that messages are about: the first without a problem, or with a mask, or else the first."""
        return next(iter((*self.clear, *(view for view in self.views if view.given), self.views[0])))

    @property
    def problem(self) -> str | None:
        """Why no view says anything about the pose; None if one may."""
        return self.main.problem

    @property
    def source(self) -> str:
        """What the evidence is taken from, for messages."""
        return "mask" if any(view.given for view in (self.main, *self.clear)) else "image"

    @property
    def any_same(self) -> bool:
        """Whether the image of a view without a problem is that of the time before."""
        return any(view.same for view in self.clear)

    @property
    def masks(self) -> dict[str, Bool]:
        """The masks of the views without a problem by name, of those that are given."""
        return {view.name: view.mask for view in self.clear if view.given}

    @property
    def ignored(self) -> dict[str, Bool]:
        """The ignored pixels by name of the view."""
        return {view.name: view.ignore for view in self.views if view.ignore is not None}

    def copied(self) -> Seen:
        """Return the same with arrays of its own, which no later image overwrites."""
        return Seen(tuple(deepcopy(view, {id(view.camera): view.camera}) for view in self.views))

    def without_frozen(self) -> Seen:
        """Return the same with a problem of each view whose image is that of the time before although the arm moved."""
        frozen = (image_frozen("mask" if view.given else "image", view.same) for view in self.views)
        pairs = zip(self.views, frozen, strict=True)
        return Seen(tuple(replace(view, problem=view.problem or problem) for view, problem in pairs))


_Look = tuple[ColourModel, Bool]
"""The colours of the instrument and its surroundings in a view, and the pixels (H, W) outside the field of view."""


class ViewSegmenter:
    """Turns the arrays of the views' images into masks, and keeps how the instrument looks in them.

    The mask of an image that has one is used, and else its colours.
    """

    def __init__(self, rig: Rig, body: Body, config: TrackConfig) -> None:
        self._rig, self._body = rig, body
        self._last: dict[str, int | None] = {}  # checksums of the latest masks or images by view, None without
        self._looks: dict[str, _Look] = {}
        self._black_level = config.black_level  # value of the brightest pixel, below which an image counts as black
        self._colour_share = config.colour_share

    def look(self, mask: Masks | None, image: Images | None, ignore: Masks | None) -> Seen:
        """Check the arrays of all views, and choose those that are used; InputError for wrong sizes, names, numbers."""
        given = {"mask": mask, "image": image, "ignore": ignore}
        arrays = [by_view(name, value, self._rig) for name, value in given.items()]
        return Seen(tuple(self._looked(view, *(each.get(view.name) for each in arrays)) for view in self._rig.views))

    def _looked(self, view: View, mask: Bool | None, image: Image | None, ignore: Bool | None) -> SeenImage:
        """Check the arrays of one view, and choose those that are used."""
        if image is not None:
            check_type("image", image, np.ndarray, "an array (H, W, 3)")
        seen = SeenImage.of(view, mask, ignore=ignore, image=None if image is not None and image.ndim == 2 else image)
        for name, array in (("mask", seen.mask), ("ignore", seen.ignore), ("image", image)):
            if array is not None:
                _check_size(name, array, view.camera)
        now, shown, surrounded = None, False, False
        if seen.given:
            now, counts = crc32(np.packbits(seen.mask).tobytes()), True if seen.ignore is None else ~seen.ignore
            shown, surrounded = seen.shows, bool((~seen.mask & counts).any())
        elif seen.image is not None:
            now = crc32(seen.image[::4].tobytes())
        problem = image_black(self._black_level if image is None else int(image.max()), self._black_level)
        if problem is None and (seen.given or seen.image is None):
            problem = mask_says_nothing(given=seen.given, shown=shown, surrounded=surrounded)
        before, self._last[view.name] = self._last.get(view.name), now
        return replace(seen, problem=problem, same=now is not None and now == before)

    def is_ready(self, seen: Seen) -> bool:
        """Whether the images have masks, or show nothing, or masks can be found in them by colours that are known."""
        return not seen.clear or any(view.given or view.name in self._looks for view in seen.clear)

    @property
    def colours(self) -> dict[str, ColourModel]:
        """The colours that were learned, by view."""
        return {name: look[0] for name, look in self._looks.items()}

    def views(self, seen: Seen) -> tuple[SeenView, ...]:
        """Return the views as they were seen: with the mask that is given, or the image in which one can be found."""
        views = []
        for view in seen.views:
            look = self._looks.get(view.name)
            if view.problem is not None:
                view = replace(view, mask=np.zeros_like(view.mask), given=False)
            if view.problem is not None or view.given or look is None:
                views.append(replace(view, image=None))
            else:
                views.append(view if view.image is None else view.without(look[1]))
        return tuple(views)

    def first_masks(self, seen: Seen, readings: Mapping[str, float], *, guesses: bool) -> dict[str, Bool]:
        """Return the masks by name of the view: those given, or that of the first image in which one is found.

        It is looked for by the instrument's shape, whose joints have ``readings``, rad, by name. One that is only
        guessed counts if ``guesses`` do.
        """
        given = {view.name: view.mask for view in seen.views if view.given}
        if given:
            return given
        for view in seen.clear:
            if view.image is None:
                continue
            found = segment(view.image, instrument=self._body, camera=view.camera, joints=readings)
            if found.mask.any() and (guesses or found.confidence >= GUESS):
                return {view.name: found.mask}
        return {}

    def learn(self, seen: Seen, views: Sequence[View], at: Posed) -> None:
        """Learn how the instrument, of a pose that is trusted, looks in the images."""
        places = {view.name: view for view in views}
        for view in seen.clear:
            if view.image is None:
                continue
            colours = learned_colours(view.image, silhouette_of(at, places[view.name], self._body), view.ignore)
            if colours is not None:
                before = self._looks.get(view.name)
                colours = colours if before is None else before[0].mixed(colours, self._colour_share)
                self._looks[view.name] = colours, outside_view(view.image)


def _check_size(name: str, array: NDArray[Any], camera: Camera) -> None:
    """Raise an InputError for an array that is not of the camera's size, or for an image that is not (H, W, 3)."""
    if name == "image" and (array.dtype != np.uint8 or array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,))):
        raise InputError(f"image: expected (H, W, 3) uint8, BGR, got {array.dtype} of shape {array.shape}")
    if array.shape[:2] != (camera.height, camera.width):
        raise InputError(
            f"{name}: expected {camera.width} x {camera.height} pixels as the camera has, got an array of shape "
            f"{array.shape}"
        )
