"""Read OpenCV's FileStorage, YAML or XML, of one camera or a stereo pair.

One camera: ``camera_matrix``, ``distortion_coefficients``. A pair: the same names, or ``K`` or ``M`` and ``D``, with
``1`` and ``2``, ``L`` and ``R`` or ``left`` and ``right`` before or after them; case and underscores are ignored.
``P1`` and ``P2`` (3, 4) are for rectified images. The pose between the two cameras is read
in ``stereo``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from typing import Any

from dvrk_cmaes.camera.fields import (
    Distortion,
    Intrinsics,
    Side,
    Size,
    as_number,
    has_field,
    lens_of,
    one_camera,
    opencv_distortion,
    take_field,
    take_length,
    take_matrix,
    take_numbers,
    take_size,
)
from dvrk_cmaes.camera.other_formats import FORMAT
from dvrk_cmaes.errors import InputError

_MATRIX = ("cameramatrix", "k")
_DISTORTION = ("distortioncoefficients", "distcoeffs", "d")
_NUMBERED = {"left": "1", "right": "2"}
_USUAL = {
    side: (
        (f"k{n}", f"m{n}", f"cameramatrix{n}", f"{side}cameramatrix"),
        (f"d{n}", f"distcoeffs{n}", f"{side}distortioncoefficients"),
        (f"p{n}", f"{side}projectionmatrix"),
    )
    for side, n in _NUMBERED.items()
}
"""Usual names of intrinsic matrix, distortion and projection matrix of each camera of a pair, which messages state."""
_SIZES = ("imagedimensions", "imagesize", "size")


def read_storage_xml(where: str, root: ElementTree.Element) -> dict[str, Any]:
    """Convert an XML FileStorage to a document of plain values: ``{name: {"dt", "data"} or text}``."""
    if root.tag != "opencv_storage":
        raise InputError(f"{where}: expected OpenCV's XML, whose root element is <opencv_storage>, got <{root.tag}>")
    document: dict[str, Any] = {}
    for element in root:
        if element.get("type_id") in ("opencv-matrix", "opencv-nd-matrix"):
            matrix: dict[str, Any] = {child.tag: (child.text or "").strip() for child in element}
            document[element.tag] = {**matrix, "data": (element.findtext("data") or "").split()}
        else:
            document[element.tag] = (element.text or "").strip()
    return document


def is_storage(document: Mapping[str, Any]) -> bool:
    """Whether a document has matrices of a FileStorage (with a type ``dt``) or the field names of a stereo pair."""
    plain = plain_names(document)
    typed = any(isinstance(value, Mapping) and "dt" in value and "data" in value for value in plain.values())
    return typed or is_stereo_storage(document)


def is_stereo_storage(document: Mapping[str, Any]) -> bool:
    """Whether a document has the field names of a stereo pair."""
    plain = plain_names(document)
    return any(has_field(plain, _names(side)[0]) for side in ("left", "right"))


def read_storage(where: str, document: Mapping[str, Any], *, rectified: bool, side: Side) -> Intrinsics:
    """Read the intrinsics of a FileStorage document; InputError names the field and what was expected."""
    plain = plain_names(document)
    spelled = {_plain(name): name for name in document}
    stereo = is_stereo_storage(document)
    matrices, distortions, projections = _names(side) if stereo else (_MATRIX, _DISTORTION, ("projectionmatrix", "p"))
    notes = () if stereo else one_camera(where, side)
    matrix, entry = _take(where, plain, spelled, matrices)
    _check_shape(where, matrix, entry)
    focal = take_matrix(where, matrix, entry)
    distortion, also, more = _distortion(where, plain, spelled, distortions)
    kind = f"{document.get(FORMAT, 'OpenCV FileStorage')}, {f'stereo, {side} camera' if stereo else 'one camera'}"
    used = f"{matrix} and {also}" if also else matrix
    images = f"raw images ({used})"
    if rectified:
        images = f"rectified images ({matrix})"
        if has_field(plain, projections):
            projection, entry = _take(where, plain, spelled, projections)
            focal, images = take_matrix(where, projection, entry, columns=4), f"rectified images ({projection})"
        else:
            lens_of(where, str(document.get(FORMAT, "OpenCV")), distortion, rectified=True)
        distortion, more = ("plumb_bob", ()), ()
    return Intrinsics(
        f"{kind}, {images}",
        _size(where, plain, spelled),
        *focal,
        *distortion,
        (*notes, *more),
        as_number(plain.get("aspectratio")) or 1.0,
    )


def _names(side: str) -> tuple[tuple[str, ...], ...]:
    """Return the normalised names of intrinsic matrix, distortion and projection matrix of one camera of a pair."""
    marks = _NUMBERED[side], side[0], side
    return (
        (*_USUAL[side][0], *_of_side(("k", "m", "cameramatrix", "intrinsics", "intrinsicmatrix"), *marks)),
        (*_USUAL[side][1], *_of_side(("d", "distcoeffs", "distortioncoefficients", "distortion"), *marks)),
        (*_USUAL[side][2], *_of_side(("p", "projectionmatrix"), *marks)),
    )


def _of_side(names: tuple[str, ...], *marks: str) -> tuple[str, ...]:
    """Return names with each mark of a side after them, and with the side's whole word, the last mark, before them."""
    return (*(f"{name}{mark}" for name in names for mark in marks), *(f"{marks[-1]}{name}" for name in names))


def _plain(name: str) -> str:
    """Normalise a field name: lower case, without underscores."""
    return name.lower().replace("_", "")


def plain_names(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a document by normalised names: lower case, without underscores."""
    return {_plain(name): value for name, value in document.items()}


def _take(where: str, plain: Mapping[str, Any], spelled: Mapping[str, str], names: tuple[str, ...]) -> tuple[str, Any]:
    """Return the first of several fields, its name spelled as in the file; InputError if there is none."""
    if not has_field(plain, names):
        usual = [name for name in names if any(name in each for kinds in _USUAL.values() for each in kinds)] or names
        shown = list(dict.fromkeys(name.upper() if len(name) <= 2 else name for name in usual))
        take_field(where, {}, [spelled.get(name, name) for name in shown])
    name, value = take_field(where, plain, names)
    return spelled[name], value


def _distortion(
    where: str, plain: Mapping[str, Any], spelled: Mapping[str, str], names: tuple[str, ...]
) -> tuple[Distortion, str, tuple[str, ...]]:
    """Read the distortion; return it with the name of its field and notes on its model."""
    name, entry = _take(where, plain, spelled, names)
    coefficients = take_numbers(where, name, entry)
    if as_number(plain.get("fisheyemodel")) == 1:
        return ("equidistant", tuple(coefficients)), name, ()
    distortion = opencv_distortion(where, name, entry)
    if len(coefficients) == 4 and any(coefficients):
        return distortion, name, (f"{name} has four coefficients: taken as k1 k2 p1 p2, not as a fisheye's",)
    return distortion, name, ()


def _check_shape(where: str, name: str, entry: Any) -> None:
    """Raise an InputError for a matrix that states another shape than 3 x 3."""
    if isinstance(entry, Mapping):
        rows, columns = as_number(entry.get("rows")), as_number(entry.get("cols"))
        if (rows, columns) != (3, 3):
            raise InputError(
                f"{where}: {name}: expected 3 rows and 3 cols, got {entry.get('rows')} and {entry.get('cols')}"
            )


def _size(where: str, plain: Mapping[str, Any], spelled: Mapping[str, str]) -> Size | None:
    """Read width and height; None if the file does not state them."""
    if has_field(plain, ("imagewidth",)) and has_field(plain, ("imageheight",)):
        return (
            take_length(where, spelled["imagewidth"], plain["imagewidth"]),
            take_length(where, spelled["imageheight"], plain["imageheight"]),
        )
    if has_field(plain, _SIZES):
        return take_size(where, *_take(where, plain, spelled, _SIZES))
    return None
