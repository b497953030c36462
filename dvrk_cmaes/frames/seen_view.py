"""A view of a frame in memory: a camera of the rig, and its mask, image, ignored pixels and jaw tips; packed masks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from dvrk_cmaes.camera import Camera, Rig, View
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Bool, Float64, Image
from dvrk_cmaes.io.arguments import checked_array, checked_mask


@dataclass(frozen=True)
class PackedMask:
    """A mask with one bit a pixel."""

    shape: tuple[int, int]
    bits: bytes

    @classmethod
    def of(cls, mask: Bool) -> PackedMask:
        """Pack a mask (H, W).

        Parameters
        ----------
        mask
            (H, W) bool.
        """
        return cls((mask.shape[0], mask.shape[1]), np.packbits(mask).tobytes())

    def restored(self) -> Bool:
        """Return the mask (H, W)."""
        height, width = self.shape
        bits = np.unpackbits(np.frombuffer(self.bits, np.uint8), count=height * width)
        return bits.reshape(height, width).astype(np.bool_)


def overlap_of(first: Bool, second: Bool) -> float:
    """Return the intersection over union of two masks; 1 if both are empty."""
    either = np.count_nonzero(first | second)
    return np.count_nonzero(first & second) / either if either else 1.0


Mask = Bool | Mapping[str, Bool | None]
"""The mask (H, W) of a camera, or those of a rig's views by name; None for a view without one."""


@dataclass(frozen=True, eq=False)
class SeenView(View):
    """A view of a frame: its camera in the rig, and what that saw.

    ``mask`` and ``ignore`` are (H, W), ``image`` (H', W', 3) BGR of the mask's aspect, ``keypoints`` (2, 2) px the jaw
    tips. The mask is empty where none is ``given``.
    """

    mask: Bool
    ignore: Bool | None = None
    image: Image | None = None
    keypoints: Float64 | None = None
    given: bool = True

    @classmethod
    def of(
        cls, view: View, mask: object, *, ignore: object = None, image: Image | None = None, keypoints: object = None
    ) -> Self:
        """Return a view with what its camera saw, converted to arrays; its mask is empty if None is given.

        Raises
        ------
        InputError
            A path, text or list that is no array of numbers, or a mask or ignored pixels that are not (H, W).
        """
        shape = view.camera.height, view.camera.width
        seen = np.zeros(shape, np.bool_) if mask is None else checked_mask("mask", mask)
        ignored = None if ignore is None else checked_mask("ignore", ignore)
        tips = None if keypoints is None else checked_array("keypoints", keypoints, np.float64, "two pixels, (2, 2)")
        return cls(view.name, view.camera, view.view_from_camera, seen, ignored, image, tips, mask is not None)

    @property
    def shows(self) -> bool:
        """Whether some of the instrument is seen where pixels count."""
        return bool((self.mask if self.ignore is None else self.mask & ~self.ignore).any())

    def without(self, pixels: Bool) -> Self:
        """Return the view in which some pixels (H, W) do not count either."""
        return replace(self, ignore=pixels if self.ignore is None else self.ignore | pixels)


Tips = ArrayLike | Mapping[str, ArrayLike | None]
"""The jaw tips (2, 2) px in the image of a camera, or those in a rig's views by name."""


def seen_views(
    mask: Mask, camera: Camera | Rig, ignore: Mask | None = None, keypoints: Tips | None = None
) -> tuple[SeenView, ...]:
    """Return the views of a frame that is given as arrays: of one camera, or by name of a rig's views.

    Raises
    ------
    InputError
        Masks by view without a rig or the other way round, a name that is no view's, or no mask at all.
    """
    rig = Rig.of(camera)
    if isinstance(camera, Camera) and any(isinstance(each, Mapping) for each in (mask, ignore, keypoints)):
        raise InputError("mask: expected a rig of cameras with masks by view, got one camera")
    given = {"mask": mask, "ignore": ignore, "keypoints": keypoints}
    masks, ignored, tips = (by_view(name, value, rig) for name, value in given.items())
    if not masks:
        kind = "an array (H, W) of bool" if isinstance(camera, Camera) else f"one of a view ({', '.join(rig.names)})"
        raise InputError(f"mask: expected {kind}, got none (of a file that cv2.imread did not find?)")
    return tuple(
        SeenView.of(view, masks.get(view.name), ignore=ignored.get(view.name), keypoints=tips.get(view.name))
        for view in rig.views
    )


def shown_views(views: Sequence[SeenView]) -> tuple[SeenView, ...]:
    """Return the views that show some of the instrument, in the rig's order; if none does, the first with a mask.

    A single view is returned whatever its mask shows.
    """
    if len(views) == 1:
        return tuple(views)
    return tuple(view for view in views if view.shows) or tuple(view for view in views if view.given)[:1]


def left_out_views(views: Sequence[SeenView]) -> tuple[str, ...]:
    """Return texts on the views of a rig that do not show the instrument: those without a mask first."""
    without = (f"view {view.name}: no mask" for view in views if not view.given)
    return (*without, *(f"view {view.name}: its mask is empty" for view in views if view.given and not view.shows))


def by_view(name: str, value: Any, rig: Rig) -> Mapping[str, Any]:
    """Return the values of an argument by view, without None: given by name, in the rig's order, or that of one view.

    InputError for a name that is no view's, or for another number of values.
    """
    if not isinstance(value, Mapping):
        listed = isinstance(value, list | tuple) and all(isinstance(each, np.ndarray | None) for each in value)
        values = [*value] if listed and (len(rig.views) > 1 or len(value) == 1) else [value]
        if value is not None and len(values) != len(rig.views):
            raise InputError(f"{name}: expected one by view ({', '.join(rig.names)}), got {len(values)}")
        value = dict(zip(rig.names, values, strict=False))
    for key in value:
        if key not in rig.names:
            raise InputError(f"{name}: expected views {', '.join(nearest_first(str(key), rig.names))}, got {key!r}")
    return {key: each for key, each in value.items() if each is not None}
