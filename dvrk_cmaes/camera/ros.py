"""Read and write ROS camera_info: a calibration file (``image_width``, ``camera_matrix: {data}``, ...) or a topic dump.

A dump has ``width``, ``K``, ``D``, ``P`` in ROS 1 and ``k``, ``d``, ``p`` in ROS 2. The camera of raw images has the
matrix K and the distortion D; that of rectified images has the left 3 x 3 part of P and no distortion.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.fields import (
    Distortion,
    Intrinsics,
    Side,
    as_number,
    has_field,
    known_lens,
    one_camera,
    take_field,
    take_length,
    take_matrix,
    take_numbers,
)
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.atomic import write_text
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.io.yaml_file import yaml_text

_MODELS = {
    "plumb_bob": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
}

# names of a field in a calibration file, in a ROS 1 message and in a ROS 2 message
_WIDTH = ("image_width", "width")
_HEIGHT = ("image_height", "height")
_RAW = ("camera_matrix", "K", "k")
_DISTORTION = ("distortion_coefficients", "D", "d")
_RECTIFIED = ("projection_matrix", "P", "p")


def is_camera_info(document: Mapping[str, Any]) -> bool:
    """Whether a document has an intrinsic or a projection matrix under one of the names of camera_info."""
    return has_field(document, (*_RAW, *_RECTIFIED))


def read_camera_info(where: str, document: Mapping[str, Any], *, rectified: bool, side: Side) -> Intrinsics:
    """Read the intrinsics of a camera_info document; InputError names the field and what was expected."""
    width, height = (take_length(where, *take_field(where, document, names)) for names in (_WIDTH, _HEIGHT))
    _refuse_region(where, document, width, height)
    notes: tuple[str, ...] = ()
    if not rectified and _is_zero(document, _RAW) and any(map(as_number, _numbers(document, _RECTIFIED))):
        rectified, notes = True, ("K is zero: the images are taken for rectified ones, with the camera of P",)
    name, entry = take_field(where, document, _RECTIFIED if rectified else _RAW)
    focal = take_matrix(where, name, entry, columns=4 if rectified else 3)
    model, distortion = ("plumb_bob", ()) if rectified else _distortion(where, document)
    frame = document.get("camera_name")
    if frame is None and isinstance(document.get("header"), Mapping):
        frame = document["header"].get("frame_id")
    form = "topic dump" if "width" in document else "calibration"
    images = f"rectified images ({name})" if rectified else f"raw images ({name} and distortion)"
    notes = (*notes, *one_camera(where, side, frame, right=_is_right(document)))
    across, down = (as_number(document.get(name)) or 1.0 for name in ("binning_x", "binning_y"))
    ratio = down / across
    return Intrinsics(f"ROS camera_info {form}, {images}", (width, height), *focal, model, distortion, notes, ratio)


def _is_zero(document: Mapping[str, Any], names: tuple[str, ...]) -> bool:
    """Whether a matrix is stated with only zeros."""
    numbers = _numbers(document, names)
    return bool(numbers) and not any(as_number(number) != 0 for number in numbers)


def _is_right(document: Mapping[str, Any]) -> bool:
    """Whether P has the baseline of a right eye; the messages of both eyes name the left one's frame."""
    numbers = _numbers(document, _RECTIFIED)
    return len(numbers) == 12 and (as_number(numbers[3]) or 0.0) < 0


def _numbers(document: Mapping[str, Any], names: tuple[str, ...]) -> list[Any]:
    """Return the flat list of a matrix's values as they are stated; empty where there is none."""
    entry = next((document[name] for name in names if document.get(name) is not None), None)
    numbers = entry.get("data") if isinstance(entry, Mapping) else entry
    return numbers if isinstance(numbers, list) else []


def _distortion(where: str, document: Mapping[str, Any]) -> Distortion:
    """Read the distortion model and its coefficients; the model may be missing if the distortion is zero."""
    coefficients = tuple(take_numbers(where, *take_field(where, document, _DISTORTION)))
    given = document.get("distortion_model")
    if given in (None, "", "none", "None") and not any(coefficients):
        return "plumb_bob", ()
    return _MODELS[known_lens(where, given, _MODELS)], coefficients


def _refuse_region(where: str, document: Mapping[str, Any], width: int, height: int) -> None:
    """Raise an InputError for a region of interest of the sensor: its pixels have another origin."""
    roi = document.get("roi")
    if not isinstance(roi, Mapping):
        return
    sizes = {"x_offset": (0,), "y_offset": (0,), "width": (0, width), "height": (0, height)}
    for key, whole in sizes.items():
        if roi.get(key, 0) not in whole:
            raise InputError(f"{where}: roi.{key}: expected images of the whole sensor, got {shown(roi[key])}")


def write_camera_info(
    path: str | Path, camera: Camera, name: str, *, baseline: float = 0.0, right_from_left: Float64 | None = None
) -> None:
    """Write a ROS camera_info YAML file for images that are not rectified; arguments as of `camera_info_text`."""
    write_text(path, camera_info_text(camera, name, baseline=baseline, right_from_left=right_from_left))


def camera_info_text(
    camera: Camera, name: str, *, baseline: float = 0.0, right_from_left: Float64 | None = None
) -> str:
    """Return ROS camera_info in YAML for images that are not rectified.

    Of a right eye, ``baseline``, m, is that of the projection matrix, and ``right_from_left`` (4, 4), m, its pose,
    which counts where it is given.
    """
    K = camera.matrix
    document = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": _matrix(K),
        "distortion_model": camera.model,
        "distortion_coefficients": _matrix(np.array([camera.distortion or (0.0,) * 5])),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(np.c_[K, [-camera.fx * baseline, 0.0, 0.0]]),
    }
    if right_from_left is not None:
        document["right_from_left"] = right_from_left.tolist()
    return yaml_text(document)


def _matrix(values: Float64) -> dict[str, Any]:
    """Return a matrix as camera_info states it."""
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}
