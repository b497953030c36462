"""Camera files: intrinsics and lens distortion as calibration tools write them.

Read so far: ROS camera_info YAML, as a calibration file (``image_width``, ``camera_matrix: {data}``, ...) and as a dump
of the topic (``width``, ``K``, ``D``, ``P`` in ROS 1, ``k``, ``d``, ``p`` in ROS 2). A raw image goes with K and D; a
rectified one with the left 3 x 3 part of P and no distortion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.shown import listed, shown
from dvrk_cmaes.io.yaml_file import read_yaml_mapping

_MODELS = {
    "plumb_bob": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
}

# what a field is called in a calibration file, in ROS 1's message and in ROS 2's
_WIDTH = ("image_width", "width")
_HEIGHT = ("image_height", "height")
_RAW = ("camera_matrix", "K", "k")
_DISTORTION = ("distortion_coefficients", "D", "d")
_RECTIFIED = ("projection_matrix", "P", "p")


Side = Literal["left", "right"]


@dataclass(frozen=True)
class CameraFile:
    """A camera and where it is from: ``kind`` of file in words, and in ``notes`` what had to be decided by a rule."""

    camera: Camera
    kind: str
    notes: tuple[str, ...] = ()


def read_camera(
    path: str | Path, *, rectified: bool = False, side: Side = "left", size: tuple[int, int] | None = None
) -> Camera:
    """Read a camera file, as ``read_camera_file`` does, for the camera alone."""
    return read_camera_file(path, rectified=rectified, side=side, size=size).camera


def read_camera_file(
    path: str | Path, *, rectified: bool = False, side: Side = "left", size: tuple[int, int] | None = None
) -> CameraFile:
    """Read a camera file of any kind, told by its content.

    Parameters
    ----------
    path
        The file.
    rectified
        Whether the images are rectified; raw ones otherwise.
    side
        Which camera of a stereo pair.
    size
        Width and height in pixels of the images, for a file that does not state them.

    Returns
    -------
    CameraFile
        Pixels as in the file, at the size of its images.

    Raises
    ------
    InputError
        Naming the file, the field and what was expected.
    """
    document = read_yaml_mapping(path, expected="a camera file (ROS camera_info YAML)")
    if not any(name in document for name in (*_RAW, *_RECTIFIED)):
        raise InputError(
            f"{path}: expected a ROS camera_info file with camera_matrix and projection_matrix "
            f"(or K and P, or k and p), got the fields {listed(document) or '(none)'}"
        )
    return CameraFile(_camera_info(path, document, rectified=rectified), "ROS camera_info")


def _camera_info(path: str | Path, document: Mapping[str, Any], *, rectified: bool) -> Camera:
    """Camera of a ROS camera_info document."""
    width, height = _size(path, document, _WIDTH), _size(path, document, _HEIGHT)
    _refuse_region(path, document, width, height)
    name, entry = _field(path, document, _RECTIFIED if rectified else _RAW)
    columns = 4 if rectified else 3
    matrix = _numbers(path, name, entry, count=3 * columns)
    fx, skew, cx = matrix[:3]
    below, fy, cy = matrix[columns : columns + 3]
    if fx <= 0 or fy <= 0:
        raise InputError(f"{path}: {name}: expected positive focal lengths in pixels, got fx {fx:g}, fy {fy:g}")
    if max(abs(skew), abs(below)) > 1e-6 * fx or matrix[2 * columns : 2 * columns + 3] != [0, 0, 1]:
        raise InputError(f"{path}: {name}: expected rows fx 0 cx, 0 fy cy, 0 0 1 (no skew), got {matrix}")
    model, distortion = ("plumb_bob", ()) if rectified else _distortion(path, document)
    try:
        return Camera(width, height, fx, fy, cx, cy, distortion, model)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _distortion(path: str | Path, document: Mapping[str, Any]) -> tuple[str, tuple[float, ...]]:
    """Distortion model and its coefficients; an unnamed model will do where there is no distortion."""
    name, entry = _field(path, document, _DISTORTION)
    coefficients = tuple(_numbers(path, name, entry))
    given = document.get("distortion_model")
    if given in (None, "") and not any(coefficients):
        return "plumb_bob", ()
    if not isinstance(given, str) or given not in _MODELS:
        names = ", ".join(nearest_first(given[:60], _MODELS) if isinstance(given, str) else _MODELS)
        raise InputError(f"{path}: distortion_model: expected one of {names}, got {shown(given)}")
    return _MODELS[given], coefficients


def _field(path: str | Path, document: Mapping[str, Any], names: tuple[str, ...]) -> tuple[str, Any]:
    """Name and value of the first of several names that the document has."""
    for name in names:
        if document.get(name) is not None:
            return name, document[name]
    raise InputError(f"{path}: {names[0]}: missing (expected {' or '.join(names)})")


def _size(path: str | Path, document: Mapping[str, Any], names: tuple[str, ...]) -> int:
    name, value = _field(path, document, names)
    number = _number(value)
    if number is None or not math.isfinite(number) or number != int(number) or number <= 0:
        raise InputError(f"{path}: {name}: expected a positive whole number of pixels, got {shown(value)}")
    return int(number)


def _numbers(path: str | Path, name: str, entry: Any, count: int | None = None) -> list[float]:
    """Finite numbers of a flat list, or of the ``data`` of a mapping."""
    if isinstance(entry, Mapping):
        name, entry = f"{name}.data", entry.get("data")
    expected = f"{count} numbers" if count else "a list of numbers"
    if not isinstance(entry, list):
        raise InputError(f"{path}: {name}: expected {expected}, got {shown(entry)}")
    if count is not None and len(entry) != count:
        raise InputError(f"{path}: {name}: expected {expected}, got {len(entry)}")
    numbers = []
    for value in entry:
        number = _number(value)
        if number is None or not math.isfinite(number):
            raise InputError(f"{path}: {name}: expected finite numbers, got {shown(value)}")
        numbers.append(number)
    return numbers


def _number(value: Any) -> float | None:
    """Float of a number or of its text (YAML 1.1 takes 1e-05 for text), None of anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        return float(value)
    except (ValueError, OverflowError):
        return None


def _refuse_region(path: str | Path, document: Mapping[str, Any], width: int, height: int) -> None:
    """Refuse a message whose images are a part of the sensor's: their pixels count from another corner."""
    roi = document.get("roi")
    if not isinstance(roi, Mapping):
        return
    sizes = {"x_offset": (0,), "y_offset": (0,), "width": (0, width), "height": (0, height)}
    for key, whole in sizes.items():
        if roi.get(key, 0) not in whole:
            raise InputError(f"{path}: roi.{key}: expected images of the whole sensor, got {shown(roi[key])}")
