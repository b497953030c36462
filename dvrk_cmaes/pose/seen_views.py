"""Masks of the views of a rig, checked and reduced to the views that show the instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.errors import InputError, nearest_first

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]
Mask = Bool | Mapping[str, Bool | None]
"""The mask (H, W) of a camera, or those of a rig's views by name; None for a view without one."""


@dataclass(frozen=True, eq=False)
class SeenView:
    """A view with a mask: name, mask (H, W), ignored pixels (H, W), tips (2, 2) px, camera and ``view_from_camera``."""

    name: str
    mask: Bool
    ignore: Bool | None
    keypoints: Float64 | None
    camera: Camera
    view_from_camera: Float64


def seen_views(
    mask: Mask,
    camera: Camera | Rig,
    ignore: Mask | None = None,
    keypoints: ArrayLike | Mapping[str, ArrayLike | None] | None = None,
) -> tuple[tuple[SeenView, ...], tuple[str, ...]]:
    """Return the views that show some of the instrument, in the rig's order, and texts on the others.

    A single camera is a view named ``left`` whatever its mask shows. Where no view of a rig shows the instrument, the
    first one with a mask is returned.

    Raises
    ------
    InputError
        Masks by view without a rig or the other way round, a name that is no view's, or no mask at all.
    """
    if isinstance(camera, Camera):
        if any(isinstance(each, Mapping) for each in (mask, ignore, keypoints)):
            raise InputError("mask: expected a rig of cameras with masks by view, got one camera")
        return (_view("left", camera, np.eye(4), mask, ignore, keypoints),), ()
    masks, ignored, tips = (
        _by_view("mask", mask, camera),
        _by_view("ignore", ignore, camera),
        _by_view("keypoints", keypoints, camera),
    )
    views = tuple(
        _view(
            view.name, view.camera, view.view_from_camera, masks[view.name], ignored.get(view.name), tips.get(view.name)
        )
        for view in camera.views
        if masks.get(view.name) is not None
    )
    if not views:
        raise InputError(f"mask: expected one for at least one view ({', '.join(camera.names)}), got none")
    shown = tuple(view for view in views if (view.mask if view.ignore is None else view.mask & ~view.ignore).any())
    unused = [f"view {name}: no mask" for name in camera.names if masks.get(name) is None]
    unused += [f"view {view.name}: its mask is empty" for view in views if view not in shown]
    return shown or views[:1], tuple(unused)


def _by_view(name: str, value: object, rig: Rig) -> Mapping[str, object]:
    """Return the values of an argument by view; a rig of one view takes a value that is not by view."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        if len(rig.views) == 1:
            return {rig.names[0]: value}
        raise InputError(f"{name}: expected one by view ({', '.join(rig.names)}), got one array")
    for key in value:
        if key not in rig.names:
            raise InputError(f"{name}: expected views {', '.join(nearest_first(str(key), rig.names))}, got {key!r}")
    return value


def _view(
    name: str, camera: Camera, view_from_camera: Float64, mask: object, ignore: object, keypoints: object
) -> SeenView:
    """Return a view with its arguments converted to arrays."""
    return SeenView(
        name,
        np.asarray(mask, dtype=np.bool_),
        None if ignore is None else np.asarray(ignore, dtype=np.bool_),
        None if keypoints is None else np.asarray(keypoints, dtype=np.float64),
        camera,
        view_from_camera,
    )
