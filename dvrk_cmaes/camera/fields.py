"""Intrinsics as stated in a camera file, and readers of the fields that several file formats share.

The reader of each format converts a document of plain values to `Intrinsics`; an InputError names a wrong field.
Values that are unusual get a remark: what the file says may be wrong, although it can be used. A few are those of a
known mistake, which no camera was seen to have: results by them are doubtful.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

from dvrk_cmaes.camera.model import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import shown

Side = Literal["left", "right"]
Size = tuple[int, int]
Lens = tuple[str, tuple[float, ...]]
"""Model and coefficients."""

ONE_CAMERA = "the file holds one camera: it is taken for the right one"

_LARGEST = 1e6  # px, of a focal length or a principal point
_LEAST_FOCAL = 0.1
"""Least focal length, as a share of the image's longer side: a view of 157 deg."""

_OPENCV_COUNTS = (0, 4, 5, 8, 12, 14)


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics and distortion that a camera file states for one camera.

    ``kind`` describes the file format and which of its cameras and matrices were used. ``size`` is width and height in
    pixels, None if the file does not state them. ``fx, fy, cx, cy`` are in pixels; ``model`` and ``distortion`` are as
    in `Camera`. ``notes`` state assumptions that were made about the file. ``ratio`` is the fx / fy that the file
    states in addition to the focal lengths, as by an uneven binning.
    """

    kind: str
    size: Size | None
    fx: float
    fy: float
    cx: float
    cy: float
    model: str = "plumb_bob"
    distortion: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()
    ratio: float = 1.0

    def camera(self, where: str | Path, size: Size) -> Camera:
        """Return the camera for images of a size, px, with remarks on it; an InputError begins with ``where``.

        A focal length of a few units is one in millimetres, and refused.
        """
        for name, value in (("fx", self.fx), ("fy", self.fy), ("cx", self.cx), ("cy", self.cy)):
            if abs(value) > _LARGEST:
                raise InputError(f"{where}: {name}: expected at most {_LARGEST:g} px, got {value:g}")
        for name, focal in (("fx", self.fx), ("fy", self.fy)):
            if focal < _LEAST_FOCAL * max(size):
                raise InputError(
                    f"{where}: {name}: expected a focal length in pixels, got {focal:g} for images of {size[0]} x "
                    f"{size[1]} px: this looks like millimetres (pixels = millimetres / pitch of the sensor's pixels)"
                )
        try:
            camera = Camera(*size, self.fx, self.fy, self.cx, self.cy, self.distortion, self.model)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        return replace(camera, remarks=remarks_on(*size, self.fx, self.fy, self.cx, self.cy, ratio=self.ratio))


def take_field(where: str, document: Mapping[str, Any], names: Sequence[str]) -> tuple[str, Any]:
    """Return name and value of the first of several fields that a document has; InputError if it has none of them."""
    for name in names:
        if document.get(name) is not None:
            return name, document[name]
    raise InputError(f"{where}: {names[0]}: missing (expected {' or '.join(names)})")


def has_field(document: Mapping[str, Any], names: Sequence[str]) -> bool:
    """Whether a document has one of several fields."""
    return any(document.get(name) is not None for name in names)


def take_length(where: str, name: str, value: Any) -> int:
    """Convert a width or height to a positive whole number of pixels; InputError otherwise."""
    number = as_number(value)
    if number is None or not math.isfinite(number) or number != int(number) or number <= 0:
        raise InputError(f"{where}: {name}: expected a positive whole number of pixels, got {shown(value)}")
    return int(number)


def take_numbers(where: str, name: str, entry: Any, count: int | None = None) -> list[float]:
    """Read finite numbers from a flat list, a list of rows, or the ``data`` of a mapping; InputError otherwise."""
    if isinstance(entry, Mapping):
        name, entry = f"{name}.data", entry.get("data")
    expected = f"{count} numbers" if count else "a list of numbers"
    if not isinstance(entry, list):
        raise InputError(f"{where}: {name}: expected {expected}, got {shown(entry)}")
    if entry and all(isinstance(row, list) for row in entry):
        entry = [value for row in entry for value in row]
    if count is not None and len(entry) != count:
        raise InputError(f"{where}: {name}: expected {expected}, got {len(entry)}")
    numbers = []
    for value in entry:
        number = as_number(value)
        if number is None or not math.isfinite(number):
            raise InputError(f"{where}: {name}: expected finite numbers, got {shown(value)}")
        numbers.append(number)
    return numbers


def as_number(value: Any) -> float | None:
    """Convert a number, or the text of one (1e-05 is text in YAML 1.1), to a float; None for other values."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        return float(value)
    except (ValueError, OverflowError):
        return None


def take_matrix(where: str, name: str, entry: Any) -> tuple[float, float, float, float]:
    """Read fx, fy, cx, cy from an intrinsic matrix (3, 3) or a projection matrix (3, 4), in row-major order."""
    matrix = take_numbers(where, name, entry)
    if len(matrix) not in (9, 12):
        raise InputError(f"{where}: {name}: expected 9 numbers, got {len(matrix)}")
    columns = len(matrix) // 3
    fx, skew, cx = matrix[:3]
    below, fy, cy = matrix[columns : columns + 3]
    if fx <= 0 or fy <= 0:
        raise InputError(f"{where}: {name}: expected positive focal lengths in pixels, got fx {fx:g}, fy {fy:g}")
    if max(abs(skew), abs(below)) > 1e-6 * fx or matrix[2 * columns : 2 * columns + 3] != [0, 0, 1]:
        raise InputError(f"{where}: {name}: expected rows fx 0 cx, 0 fy cy, 0 0 1 (no skew), got {matrix}")
    return fx, fy, cx, cy


def opencv_distortion(where: str, name: str, entry: Any) -> Lens:
    """Read a vector of distortion coefficients in OpenCV's order; their number determines the model.

    0, 4 or 5 coefficients are k1 k2 p1 p2 [k3]; 8 coefficients continue with k4 k5 k6; the thin prism and tilt
    coefficients of vectors of 12 and 14 must be zero.
    """
    coefficients = take_numbers(where, name, entry)
    if len(coefficients) not in _OPENCV_COUNTS:
        counts = ", ".join(map(str, _OPENCV_COUNTS[:-1]))
        raise InputError(
            f"{where}: {name}: expected {counts} or {_OPENCV_COUNTS[-1]} coefficients, got {len(coefficients)}"
        )
    if any(coefficients[8:]):
        raise InputError(f"{where}: {name}: expected no thin prism or tilt (coefficients 9 on), got {coefficients[8:]}")
    return ("rational_polynomial" if len(coefficients) > 5 else "plumb_bob"), tuple(coefficients[:8])


def one_camera(where: str, side: Side, name: object = None, *, right: bool = False) -> tuple[str, ...]:
    """Return the notes on using a file of one camera for a side; InputError for the left one where right is asked.

    ``right``: the file states a right eye's baseline, which counts more than its name.
    """
    if side == "left" or right:
        return ()
    if isinstance(name, str) and "left" in name.lower() and "right" not in name.lower():
        raise InputError(f"{where}: --side right: expected the right camera, got {shown(name)}")
    return (ONE_CAMERA,)


FILE: Final = "camera file: "
"""What every remark begins with."""
WRONG: Final = f"{FILE}most likely wrong: "
"""What a remark on values of a known mistake begins with."""

_APART = 0.03  # of the focal lengths, beyond which they are not equal
_STRETCHED = 0.1, 0.4  # the same as of images that were stretched; fields are so by half
_AT_MISTAKE = 0.06  # of the width, from where a mistake puts the principal point
_OFF_CENTRE = 0.12  # of the width, from the middle of the image
_STATED = (0.1, 10.0)  # ratios of a file that are taken for such
_FOCAL = (0.4, 4.0)  # image widths
_VIDEO = ((720, 576), (704, 576), (360, 288), (352, 288), (720, 480), (704, 480), (360, 240), (352, 240))
"""Sizes of digitised video, whose pixels are not square: the whole picture is 4 : 3."""


def remarks_on(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, *, ratio: float = 1.0
) -> tuple[str, ...]:
    """Return a remark on each value of a camera file that is unusual; empty if none is.

    Real cameras may have such values, as those of cropped or rectified images do.

    Parameters
    ----------
    width, height
        Size of the images, px.
    fx, fy, cx, cy
        Focal lengths and principal point, px.
    ratio
        fx / fy that the file states in addition to the focal lengths, as by an uneven binning.
    """
    size, remarks = f"{width} x {height} px", []
    of_video = width / height * 3 / 4 if (width, height) in _VIDEO else 1.0
    usual = (1.0, of_video, ratio if _STATED[0] < ratio < _STATED[1] else 1.0)
    apart = math.expm1(min(abs(math.log(fx / fy / each)) for each in usual))
    if apart > _APART:
        begins = WRONG if _STRETCHED[0] < apart < _STRETCHED[1] else FILE
        remarks.append(
            f"{begins}fx {fx:g} and fy {fy:g} are {100 * abs(fx / fy - 1):.0f} % apart, as pixels of {size} "
            "seldom are; check both, or whether the images were stretched"
        )
    off = (cx + 0.5 - width / 2) / width, (cy + 0.5 - height / 2) / height
    distance = math.hypot(off[0] * width, off[1] * height)
    from_exchanged = math.hypot(cx + 0.5 - height / 2, cy + 0.5 - width / 2)
    if from_exchanged < distance:
        begins = WRONG if from_exchanged < _AT_MISTAKE * width else FILE
        remarks.append(
            f"{begins}principal point {cx:g}, {cy:g} is nearer to {height / 2:g}, {width / 2:g} than to the "
            f"middle of {size}, {width / 2:g}, {height / 2:g}; cx and cy, or width and height, may be exchanged"
        )
    elif math.hypot(cx + 0.5 - width / 4, cy + 0.5 - height / 4) < _AT_MISTAKE * width:
        remarks.append(
            f"{WRONG}principal point {cx:g}, {cy:g} is a quarter of {size}: the file is of images of half the size"
        )
    elif distance > _OFF_CENTRE * width:
        across = f"{100 * abs(off[0]):.0f} % of the width {'right' if off[0] > 0 else 'left'}"
        along = f"{100 * abs(off[1]):.0f} % of the height {'below' if off[1] > 0 else 'above'}"
        remarks.append(
            f"{FILE}principal point {cx:g}, {cy:g}: {across} and {along} of the middle of {size}; usual for "
            "cropped or rectified images, otherwise check the camera file's size, cx and cy"
        )
    if not all(_FOCAL[0] <= each / width <= _FOCAL[1] for each in (fx, fy)):
        remarks.append(
            f"{FILE}focal lengths {fx:g} and {fy:g} px are {fx / width:.2g} image widths; usual are "
            f"{_FOCAL[0]:g} to {_FOCAL[1]:g}: check the camera file's size, fx and fy"
        )
    return tuple(remarks)


def known_mistakes(remarks: Iterable[str]) -> list[str]:
    """Return those of some remarks that name a known mistake of a camera file, of any view.

    Parameters
    ----------
    remarks
        Those of `remarks_on`, after the name of a view or not.
    """
    return [text for text in remarks if WRONG in text]
