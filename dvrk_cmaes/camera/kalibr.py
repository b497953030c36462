"""Read kalibr's camchain: cam0, cam1, ... with ``camera_model``, ``intrinsics``, ``distortion_model``, ``resolution``.

Only the camera model ``pinhole`` is supported. The distortion model ``radtan`` is OpenCV's plumb_bob, ``equidistant``
its fisheye. The left and right camera of a pair are recognised by their topics, otherwise cam0 is the left one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from dvrk_cmaes.camera.fields import (
    Intrinsics,
    Side,
    known_lens,
    lens_of,
    one_camera,
    take_field,
    take_numbers,
    take_size,
)
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import shown

_NAME = re.compile(r"cam\d+")
_MODELS = {"radtan": ("plumb_bob", 4), "equidistant": ("equidistant", 4), "equi": ("equidistant", 4), "none": None}


def is_camchain(document: Mapping[str, Any]) -> bool:
    """Whether a document has a camera with a name of kalibr's, such as cam0."""
    return any(_NAME.fullmatch(name) and isinstance(entry, Mapping) for name, entry in document.items())


def read_camchain(where: str, document: Mapping[str, Any], *, rectified: bool, side: Side) -> Intrinsics:
    """Read one camera of a camchain; InputError names the camera, the field and what was expected."""
    cameras = kalibr_cameras(document)
    name, notes = chosen_camera(where, cameras, side)
    entry, inside = cameras[name], f"{where}: {name}"
    _, model = take_field(inside, entry, ("camera_model",))
    if model != "pinhole":
        raise InputError(f"{inside}: camera_model: expected pinhole, got {shown(model)}, which cannot be rendered")
    fx, fy, cx, cy = take_numbers(inside, *take_field(inside, entry, ("intrinsics",)), count=4)
    if fx <= 0 or fy <= 0:
        raise InputError(f"{inside}: intrinsics: expected positive focal lengths in pixels, got fx {fx:g}, fy {fy:g}")
    _, lens = take_field(inside, entry, ("distortion_model",))
    known = _MODELS[known_lens(inside, lens, _MODELS)]
    distortion: tuple[str, tuple[float, ...]] = ("plumb_bob", ())
    if known is not None:
        coefficients = take_numbers(inside, *take_field(inside, entry, ("distortion_coeffs",)), count=known[1])
        distortion = known[0], tuple(coefficients)
    kind = f"kalibr camchain, {name} of {len(cameras)}"
    distortion = lens_of(inside, "kalibr camchain", distortion, rectified=rectified)
    size = None if entry.get("resolution") is None else take_size(inside, "resolution", entry["resolution"])
    images = "rectified images (intrinsics)" if rectified else f"raw images (intrinsics and {lens} distortion)"
    return Intrinsics(f"{kind}, {images}", size, fx, fy, cx, cy, *distortion, notes)


def kalibr_cameras(document: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the cameras of a camchain by name."""
    return {name: entry for name, entry in document.items() if _NAME.fullmatch(name) and isinstance(entry, Mapping)}


def chosen_camera(where: str, cameras: Mapping[str, Mapping[str, Any]], side: Side) -> tuple[str, tuple[str, ...]]:
    """Return the name of the camera of one side, and notes on its choice."""
    topics = {name: str(entry.get("rostopic", "")) for name, entry in cameras.items()}
    if len(cameras) == 1:
        ((name, topic),) = topics.items()
        return name, one_camera(where, side, topic)
    told = [name for name, topic in topics.items() if side in topic.lower()]
    if len(told) == 1:
        return told[0], ()
    if not (set(cameras) == {"cam0", "cam1"} and not told):
        raise InputError(
            f"{where}: --side {side}: expected cam0 and cam1, or topics that say left and right, got {topics}"
        )
    name = "cam0" if side == "left" else "cam1"
    return name, (f"the topics do not say which camera is the left one: cam0 is, so {name} is taken",)
