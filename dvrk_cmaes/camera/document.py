"""Read one camera of a document of plain values, whatever names the tool that wrote it gave the fields.

Case, underscores and hyphens of names are ignored. What a field states is found in one table; a field that is in none
of its rows and may state something of the lens is refused by name. A pair of cameras has the same fields with ``1`` and
``2``, ``L`` and ``R`` or ``left`` and ``right`` before or after their names, a mapping for each eye, or kalibr's
``cam0`` and ``cam1``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from dvrk_cmaes.camera.fields import (
    Intrinsics,
    Side,
    Size,
    as_number,
    one_camera,
    opencv_distortion,
    take_length,
    take_matrix,
    take_numbers,
)
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.short_text import listed, shown

FORMAT: Final = "calibration_format"
"""Field of a converted document with the name of its tool."""

ROLES: Final = {
    "matrix": r"k|m|mtx|camk|intrinsics?(matrix)?|cam(era)?(intrinsics?)?(matrix|mtx)",
    "lens": r"d|coef+s?|coef+icients|(lens)?dist(ort(ion)?)?s?(coef+(icient)?s?|params?|parameters?|vector)?",
    "projection": r"p|projection(matrix)?|(optimal)?new(camera)?(matrix|mtx)|optimalcamera(matrix|mtx)",
    "model": r"(distortion|lens|dist)(model|type)",
    "camera model": r"(camera)?model|camera(type|modeltype)|projectiontype",
    "fisheye": r"(is)?fisheye(model)?",
    "width": r"(image|img)?width|w",
    "height": r"(image|img)?height|h",
    "size": r"(image|img)?(size|resolution|dimensions?|shape)",
    "aspect": r"aspectratio",
    "fx": "fx",
    "fy": "fy",
    "cx": "cx|ppx",
    "cy": "cy|ppy",
    "roi": "roi",
    "binning x": "binningx",
    "binning y": "binningy",
}
"""What a field states, and the pattern of its name in lower case without underscores."""

_COEFFICIENT = re.compile(r"k[1-6]|p[12]")
_MARKED = re.compile(r"(left|right)(.+)|(.+?)(left|right|[lr12])")
_CAMERA = re.compile(r"cam\d+")
_LENS_WORD = re.compile(r"dist|lens|coef|radial|tangent|prism|tilt|skew|fish|model|proj|zoom|crop|scale|[kp]\d")
_SPREAD = re.compile(r"error|rms|reproj|std|deviation|variance|uncertain")
_WITHOUT_LENS = re.compile(
    r"[rtefq]|r[12lr]|t[12lr]|ret|mse|id|seq|.*(name|date|time|stamp|header|frame|comment|note|descr|author|version|"
    r"serial|board|square|pattern|marker|corner|grid|count|num|nrof|images|views|flag|fix|criteria|confidence|points|[rt]vecs?|"
    r"extrinsic|pose|rotation|translation|transform|essential|fundamental|rectif|fromleft|handeye|baseline|w2c|depth|unit|"
    r"pixel|sensor|fov|topic|overlaps|tcn|tcam|cami?mu|fps|rate|encoding|device|driver|method|side|roi).*"
)
_KNOWN = (
    *(
        "camera_matrix",
        "distortion_coefficients",
        "dist_coeffs",
        "distortion_model",
        "projection_matrix",
        "image_width",
    ),
    *("image_height", "image_size", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "K1", "D1", "K2", "D2"),
)
_MODELS = {
    "plumb_bob": ("radtan", "radial tangential", "Brown Conrady", "brown", "opencv"),
    "rational_polynomial": ("rational",),
    "equidistant": ("fisheye", "equi", "kannala brandt", "kannala brandt 4", "opencv fisheye"),
    "none": ("", "no distortion", "undistorted"),
}
_MODEL_OF = {re.sub(r"[^a-z]", "", n.lower()): model for model, names in _MODELS.items() for n in (model, *names)}
_COUNTS = "458"  # of coefficients, which may end a model's name
_PINHOLE = ("pinhole", "perspective", "simplepinhole")
_STRICT_ROLES = ("matrix", "lens", "projection", "fx", "fy", "cx", "cy")


_Fields = dict[str, tuple[str, Any]]
"""Name as in the file, and value, of each role."""


def plain(name: str) -> str:
    """Normalise a field's name: lower case, without underscores, hyphens and blanks."""
    return re.sub(r"[-_ .]", "", str(name).lower())  # a nested document of YAML may have numbers as names


def plain_names(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a document by normalised names."""
    return {plain(name): value for name, value in document.items()}


def is_stereo(document: Mapping[str, Any]) -> bool:
    """Whether a document has intrinsics whose names say left or right."""
    return any(
        marked is not None and marked[0] in ("matrix", "fx")
        for marked in (_marked(plain(name), value) for name, value in document.items())
    )


def is_pair(document: Mapping[str, Any]) -> bool:
    """Whether a document has a mapping for each camera of a pair."""
    return all(isinstance(document.get(name), dict) for name in ("left", "right"))


def is_camchain(document: Mapping[str, Any]) -> bool:
    """Whether a document is kalibr's: cameras with names such as cam0."""
    return bool(kalibr_cameras(document))


def is_camera(document: Mapping[str, Any]) -> bool:
    """Whether a document has the intrinsics of a camera of any format."""
    roles = {_role(plain(name), value) for name, value in document.items() if value is not None}
    mono = "matrix" in roles or "projection" in roles or {"fx", "fy", "cx", "cy"} <= roles
    return mono or is_stereo(document) or is_camchain(document) or is_pair(document)


def read_fields(where: str, document: Mapping[str, Any], *, rectified: bool, side: Side) -> Intrinsics:
    """Read the intrinsics of a camera, or of one side of a pair; InputError names the field and what was expected."""
    kind, stereo = str(document.get(FORMAT, "")), False
    notes: tuple[str, ...] = ()
    if is_camchain(document):
        where, document, kind, notes = _of_camchain(where, document, side)
    elif is_pair(document):
        rest = {name: value for name, value in document.items() if name not in ("left", "right")}
        where, document, kind = f"{where}: {side}", {**rest, **unwrapped(document[side])}, "one camera of two"
    else:
        stereo = is_stereo(document)
        notes = () if stereo else one_camera(where, side, _frame_of(document), right=_is_right(document))
        kind = f"{kind or 'OpenCV'}, stereo, {side} camera" if stereo else kind or _kind(document)
    if not is_camera(document):
        raise _unknown_layout(where, document)
    fields = _sorted_fields(where, document, side if stereo else None)
    images, size, focal, lens, more = _intrinsics(where, fields, rectified, side if stereo else None)
    return Intrinsics(f"{kind}, {images}", size, *focal, *lens, (*notes, *more), _ratio(fields))


def unwrapped(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the camera in a document that is nested under a single key, with the fields that stand around it."""
    if document and all(isinstance(entry, Mapping) and "cam_K" in entry for entry in document.values()):
        return {FORMAT: "BOP scene_camera", "distortion": [], **next(iter(document.values()))}
    nested = {name: unwrapped(value) for name, value in document.items() if isinstance(value, dict)}
    cameras = {name: value for name, value in nested.items() if is_camera(value)}
    if is_camera(document) or len(cameras) != 1:
        return dict(document)
    ((inside, found),) = cameras.items()
    return {**{name: value for name, value in document.items() if name != inside}, **found}


def kalibr_cameras(document: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the cameras of a camchain by name."""
    return {
        name: entry for name, entry in document.items() if _CAMERA.fullmatch(str(name)) and isinstance(entry, Mapping)
    }


def chosen_camera(where: str, cameras: Mapping[str, Mapping[str, Any]], side: Side) -> tuple[str, tuple[str, ...]]:
    """Return the name of the camera of one side, and notes on its choice."""
    topics = {name: str(entry.get("rostopic", "")) for name, entry in cameras.items()}
    if len(cameras) == 1:
        ((name, topic),) = topics.items()
        return name, one_camera(where, side, topic)
    of_side = [name for name, topic in topics.items() if side in topic.lower()]
    if len(of_side) == 1:
        return of_side[0], ()
    if set(cameras) != {"cam0", "cam1"} or of_side:
        raise InputError(
            f"{where}: --side {side}: expected cam0 and cam1, or topics that say left and right, got {topics}"
        )
    name = "cam0" if side == "left" else "cam1"
    return name, (f"the topics do not say which camera is the left one: cam0 is, so {name} is taken",)


def _of_camchain(
    where: str, document: Mapping[str, Any], side: Side
) -> tuple[str, dict[str, Any], str, tuple[str, ...]]:
    """Return where the camera of a side is in a camchain, its fields, what it is called, and notes."""
    cameras = kalibr_cameras(document)
    name, notes = chosen_camera(where, cameras, side)
    where, entry = f"{where}: {name}", dict(cameras[name])
    values = entry.pop("intrinsics", None)
    if values is None:
        raise InputError(f"{where}: intrinsics: missing")
    entry |= zip(("fx", "fy", "cx", "cy"), take_numbers(where, "intrinsics", values, 4), strict=True)
    rest = {key: value for key, value in document.items() if key not in cameras}
    return where, {**rest, **entry}, f"kalibr camchain, {name} of {len(cameras)}", notes


def _kind(document: Mapping[str, Any]) -> str:
    """Return what a document of one camera is called."""
    if "distortion_model" in document:
        return f"ROS camera_info {'topic dump' if 'width' in document else 'calibration'}"
    typed = any(isinstance(value, Mapping) and "dt" in value for value in document.values())
    return "OpenCV FileStorage, one camera" if typed else "one camera"


def _frame_of(document: Mapping[str, Any]) -> Any:
    """Return the name of a camera, or of its frame; None if neither is stated."""
    header = document.get("header")
    return document.get("camera_name", header.get("frame_id") if isinstance(header, Mapping) else None)


def _is_right(document: Mapping[str, Any]) -> bool:
    """Whether P has the baseline of a right eye; the messages of both eyes name the left one's frame."""
    entries = (value for name, value in document.items() if _role(plain(name), value) == "projection")
    numbers = list(_leaves(next(entries, None)))
    return len(numbers) == 12 and (as_number(numbers[3]) or 0.0) < 0


def _role(name: str, value: Any) -> str | None:
    """Return what a field of a plain name states; None if it is not in the table."""
    if _COEFFICIENT.fullmatch(name):
        return name if as_number(value) is not None else None
    if isinstance(value, Mapping) and "data" not in value and is_camera(value):
        return None  # a camera of its own, such as ``intrinsics: {fx, fy, cx, cy}``
    return next((role for role, pattern in ROLES.items() if re.fullmatch(pattern, name)), None)


def _marked(name: str, value: Any) -> tuple[str, Side] | None:
    """Return role and side of a field whose plain name says its side; None for others."""
    match = _MARKED.fullmatch(name)
    if match is None or _role(name, value) is not None:
        return None
    mark, base = match[1] or match[4], match[2] or match[3]
    role = _role(base, value)
    return None if role is None else (role, "left" if mark in ("left", "l", "1") else "right")


def _sorted_fields(where: str, document: Mapping[str, Any], side: Side | None) -> _Fields:
    """Return the fields of one camera by what they state; InputError for one that is not known.

    Of a pair, those of ``side`` and those of both.
    """
    fields: _Fields = {}
    for name, value in document.items():
        marked = _marked(plain(name), value) if side is not None else None
        role = marked[0] if marked is not None else _role(plain(name), value)
        if side is not None and marked is None and role in _STRICT_ROLES:
            raise InputError(f"{where}: {name}: expected a name that says which eye's, such as {name}1 and {name}2")
        if value is None or (marked is not None and marked[1] != side):
            continue
        if role is not None:
            known = fields.setdefault(role, (name, value))
            if role in _STRICT_ROLES and list(_leaves(known[1])) != list(_leaves(value)):
                raise InputError(f"{where}: {name}: expected one {role}, got {known[0]} that states another")
        elif not _is_without_lens(plain(name), value):
            raise _unknown(where, name)
    return fields


def _unknown(where: str, name: str) -> InputError:
    """Return the error for a field that is not known."""
    nearest = nearest_first(str(name).lower(), _KNOWN)[0]
    return InputError(
        f"{where}: {shown(str(name))[1:-1]}: unknown field of a camera file (nearest known: {nearest}), "
        "which may state the lens: rename it, or leave it out"
    )


def _is_without_lens(name: str, value: Any) -> bool:
    """Whether an unknown field, of a plain name, states nothing of the lens: metadata, texts, zeros."""
    leaves = list(_leaves(value))
    numbers = [as_number(leaf) for leaf in leaves]
    if not any(numbers) or _SPREAD.search(name):
        words = [leaf for leaf in leaves if isinstance(leaf, str) and as_number(leaf) is None]
        return not (words and _LENS_WORD.search(name)) or bool(_SPREAD.search(name))
    return _WITHOUT_LENS.fullmatch(name) is not None and not re.search("dist|lens|coef|radial|tangent", name)


def _leaves(value: Any) -> Iterator[Any]:
    """Yield the single values of nested lists and mappings; of a matrix those of its ``data``."""
    if isinstance(value, Mapping):
        value = [value["data"]] if "data" in value else list(value.values())
    if isinstance(value, list):
        for each in value:
            yield from _leaves(each)
    elif value is not None:
        yield value


def _intrinsics(
    where: str, fields: _Fields, rectified: bool, side: Side | None
) -> tuple[str, Size | None, tuple[float, float, float, float], tuple[str, tuple[float, ...]], tuple[str, ...]]:
    """Return what was used, size, focal lengths and principal point, lens, and notes."""
    notes: tuple[str, ...] = ()
    if not rectified and _is_zero(fields.get("matrix")) and not _is_zero(fields.get("projection")):
        rectified, notes = True, ("K is zero: the images are taken for rectified ones, with the camera of P",)
    if rectified and "projection" in fields:
        name, entry = fields["projection"]
        focal = take_matrix(where, name, entry)
        return f"rectified images ({name})", _size(where, fields, focal), focal, ("plumb_bob", ()), notes
    name, focal = _focal(where, fields, side)
    lens, used, notes = _lens(where, fields, name)
    if not rectified:
        return f"raw images ({used})", _size(where, fields, focal), focal, lens, notes
    if lens[0] == "equidistant" or any(lens[1]):
        raise InputError(
            f"{where}: --rectified: expected a projection matrix (ROS camera_info, or OpenCV with P1 and P2), got none"
        )
    return f"rectified images ({name})", _size(where, fields, focal), focal, ("plumb_bob", ()), ()


def _is_zero(field: tuple[str, Any] | None) -> bool:
    """Whether a matrix is not stated, or only as zeros."""
    return field is not None and not any(as_number(leaf) != 0 for leaf in _leaves(field[1]))


def _focal(where: str, fields: _Fields, side: Side | None) -> tuple[str, tuple[float, float, float, float]]:
    """Return fx, fy, cx, cy of raw images, and the name of what states them."""
    names = ("fx", "fy", "cx", "cy")
    found = None
    if "matrix" in fields:
        found = take_matrix(where, *fields["matrix"])
    flat = [name for name in names if name in fields]
    if not flat and found is None:
        missing = {"left": "K1 (or M1, camera_matrix_left)", "right": "K2 (or M2, camera_matrix_right)"}
        raise InputError(f"{where}: {missing[side] if side else 'camera_matrix (or K)'}: missing")
    if flat and found is None:
        if len(flat) < 4:
            raise InputError(f"{where}: {next(n for n in names if n not in fields)}: missing (with {', '.join(flat)})")
        fx, fy, cx, cy = (take_numbers(where, fields[name][0], [fields[name][1]])[0] for name in names)
        if fx <= 0 or fy <= 0:
            raise InputError(f"{where}: fx, fy: expected positive focal lengths in pixels, got fx {fx:g}, fy {fy:g}")
        return "fx, fy, cx, cy", (fx, fy, cx, cy)
    assert found is not None
    for name, value in zip(names, found, strict=True):
        if name in fields and abs(take_numbers(where, name, [fields[name][1]])[0] - value) > 1e-3:
            raise InputError(f"{where}: {name}: expected {value:g} as in {fields['matrix'][0]}, got {fields[name][1]}")
    return fields["matrix"][0], found


def _lens(where: str, fields: _Fields, matrix: str) -> tuple[tuple[str, tuple[float, ...]], str, tuple[str, ...]]:
    """Return model and coefficients of the lens, names of what was used, and notes."""
    model = _model(where, fields)
    name, entry = fields.get("lens", ("", None))
    single = {role: value for role, (_, value) in fields.items() if _COEFFICIENT.fullmatch(role)}
    if isinstance(entry, Mapping) and "data" not in entry:
        for key, value in entry.items():
            if _role(plain(str(key)), value) is None or not _COEFFICIENT.fullmatch(plain(str(key))):
                raise _unknown(where, f"{name}.{key}")
            single[plain(str(key))] = value
        entry = None
    if single and entry is not None:
        raise InputError(f"{where}: {name}: expected the distortion once, got {', '.join(single)}, too")
    if single:
        name, entry = ", ".join(single), _in_order(where, single, model)
    if entry is None:
        stated = fields.get("matrix", ("", [[]]))[1]
        if isinstance(stated, Mapping) or not (stated and isinstance(stated[0], list)):
            raise InputError(f"{where}: distortion_coefficients: missing (expected distortion_coefficients or D or d)")
        return ("plumb_bob", ()), matrix, ("the file states no distortion: taken as none",)
    used = f"{matrix} and distortion"
    coefficients = take_numbers(where, name, entry)
    if model == "equidistant":
        return (model, tuple(coefficients)), used, ()
    if model == "none" and any(coefficients):
        raise InputError(f"{where}: distortion_model: expected none of a lens without distortion, got coefficients")
    if model in (None, "none") or len(coefficients) > 8:
        found, lens = opencv_distortion(where, name, coefficients)
        model = found if model in (None, "none") else model
        four = len(lens) == 4 and any(lens)
        notes = (
            (f"{name} has four coefficients: taken as k1 k2 p1 p2, not as a fisheye's",) if four and not single else ()
        )
        return (model, lens), used, notes
    return (model, tuple(coefficients)), used, ()


def _in_order(where: str, single: Mapping[str, Any], model: str | None) -> list[float]:
    """Return coefficients that are stated by name in OpenCV's order."""
    values = {name: take_numbers(where, name, [value])[0] for name, value in single.items()}
    order = ("k1", "k2", "k3", "k4") if model == "equidistant" else ("k1", "k2", "p1", "p2", "k3")
    if model != "equidistant" and any(values.get(name) for name in ("k4", "k5", "k6")):
        order = (*order, "k4", "k5", "k6")
    wrong = [name for name, value in values.items() if name not in order and value]
    if wrong:
        raise InputError(f"{where}: {wrong[0]}: expected only {', '.join(order)} for the model {model}")
    return [values.get(name, 0.0) for name in order] if any(values.values()) or model == "equidistant" else []


def _model(where: str, fields: _Fields) -> str | None:
    """Return the distortion model that a file states; None if it does not."""
    found: dict[str, str] = {}
    for role in ("model", "camera model"):
        name, given = fields.get(role, (role, None))
        letters = re.sub(r"[^a-z0-9]", "", str(given).lower()).removeprefix("distortion").rstrip(_COUNTS)
        if given is None or (role == "camera model" and letters in _PINHOLE):
            continue
        if not isinstance(given, str) or letters not in _MODEL_OF:
            names = nearest_first(str(given)[:60], _MODELS) if isinstance(given, str) else list(_MODELS)
            more = ", pinhole" if role == "camera model" else ""
            raise InputError(f"{where}: {name}: expected one of {', '.join(names)}{more}, got {shown(given)}")
        found[_MODEL_OF[letters]] = name
    if "fisheye" in fields and fields["fisheye"][1] not in (0, "0", False):
        found["equidistant"] = fields["fisheye"][0]
    if len(found) > 1:
        raise InputError(f"{where}: {', '.join(found.values())}: expected one model, got {', '.join(found)}")
    return next(iter(found), None)


def _size(where: str, fields: _Fields, focal: tuple[float, float, float, float]) -> Size | None:
    """Return width and height; None if they are not stated.

    Of a list with a matrix in rows, as scripts write, the larger number is the width, or the height where the
    principal point would be outside.
    """
    if "width" in fields or "height" in fields:
        for role in ("width", "height"):
            if role not in fields:
                raise InputError(f"{where}: image_{role}: missing (expected image_{role} or {role})")
        width, height = (take_length(where, *fields[role]) for role in ("width", "height"))
        _refuse_region(where, fields, width, height)
        return width, height
    if "size" not in fields:
        return None
    name, entry = fields["size"]
    width, height = (take_length(where, name, value) for value in take_numbers(where, name, entry, count=2))
    rows = fields.get("matrix", ("", None))[1]
    if isinstance(rows, list) and isinstance(rows[0], list):
        height, width = sorted((width, height))
        width, height = (width, height) if focal[2] < width and focal[3] < height else (height, width)
    return width, height


def _ratio(fields: _Fields) -> float:
    """Return the fx / fy that the file states in addition to the focal lengths."""
    across, down, aspect = (as_number(fields.get(r, ("", 1))[1]) or 1.0 for r in ("binning x", "binning y", "aspect"))
    return down / across * aspect


def _refuse_region(where: str, fields: _Fields, width: int, height: int) -> None:
    """Raise an InputError for a region of interest of the sensor: its pixels have another origin."""
    name, roi = fields.get("roi", ("roi", None))
    whole = {"x_offset": (0,), "y_offset": (0,), "width": (0, width), "height": (0, height)}
    entries = roi if isinstance(roi, Mapping) else dict(zip(whole, roi, strict=False)) if isinstance(roi, list) else {}
    for key, usual in whole.items():
        if entries.get(key, 0) not in usual:
            raise InputError(
                f"{where}: {name}.{key}: expected images of the whole sensor, got {shown(entries[key])}: "
                "for images of a region subtract x_offset and y_offset from cx and cy, state the region's width and "
                "height, and leave roi out"
            )


def _unknown_layout(where: str, names: Iterable[str]) -> InputError:
    """Return the error for a file of unknown format."""
    return InputError(
        f"{where}: expected a camera file: camera_matrix or K with distortion_coefficients or D (ROS camera_info, "
        "OpenCV, JSON of scripts), K1, D1, K2 and D2 of a pair, kalibr's cam0, intrinsic and distortion, "
        "fx, fy, cx, cy, or EndoVis'; "
        f"got the fields {listed(names) or '(none)'}"
    )
