"""Convert documents of plain values to the dataclasses and msgspec structures that declare their fields.

The annotations of a class are the schema of its document. The types defined here add to the built-in ones what those do
not express: finite numbers, counts, and arrays of a fixed shape. Fields that a class does not declare are ignored.
"""

from __future__ import annotations

import sys
import threading
from abc import ABCMeta
from collections.abc import Mapping
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from msgspec import Meta, ValidationError, convert
from msgspec.json import Decoder

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.short_text import shown

T = TypeVar("T")

_preparing = threading.Lock()
_prepared: set[Any] = set()

_MAX = sys.float_info.max
_LARGEST = 1e12  # of the numbers of an array; products of larger ones overflow
_FARTHEST = 1000.0  # m, of the translation of a transform
_RIGID = 1e-4  # tolerance of R R^T = 1, for files that state few digits
_NOT_CONVERTED = (ValidationError, UnicodeEncodeError, RecursionError)  # lone surrogates, and too many levels
_EXPECTED: Mapping[Any, str] = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    tuple: "a list of objects",
    dict: "an object",
}

Number = Annotated[float, Meta(ge=-_MAX, le=_MAX, description="a finite number")]
PositiveNumber = Annotated[float, Meta(gt=0, le=_MAX, description="a number above 0")]
Count = Annotated[int, Meta(ge=0, description="a whole number of at least 0")]
Texts = Annotated[tuple[str, ...], Meta(description="a list of texts")]


def _array_type(*shape: int) -> ABCMeta:
    """Return a class for annotations of arrays of one shape; msgspec passes values of such fields to `_read_value`."""
    kind = ABCMeta("Array", (), {"shape": shape})
    kind.register(np.ndarray)
    return kind


if TYPE_CHECKING:  # arrays to a type checker, classes with a shape to msgspec
    Transform = Float64
    Point = Float64
    Pixel = Float64
    SquareOfThree = Float64
    SquareOfSix = Float64
else:
    Transform = _array_type(4, 4)  # a rigid transform
    Point = _array_type(3)
    Pixel = _array_type(2)
    SquareOfThree = _array_type(3, 3)
    SquareOfSix = _array_type(6, 6)


def prepared(kind: type[T]) -> type[T]:
    """Return a class whose fields msgspec knows, so that threads can use it.

    msgspec 0.22 crashes the process if two threads let it look up the fields of the same class at the same time.
    """
    if kind not in _prepared:
        with _preparing:
            Decoder(kind)
            _prepared.add(kind)
    return kind


def convert_document(where: str, document: object, kind: type[T], expected: Mapping[Any, str] | None = None) -> T:
    """Convert a document of plain values to the class that declares its fields.

    Parameters
    ----------
    where
        Beginning of messages, e.g. the path of the file.
    document
        Mappings, lists, text, numbers, booleans and null, as read from JSON or TOML. A whole number is accepted for a
        float; no other type is converted.
    kind
        A dataclass or msgspec structure.
    expected
        Descriptions of built-in types in messages, where they differ from those for JSON.

    Raises
    ------
    InputError
        A field is missing or wrong. The message has its full name, e.g. ``quality.iou``, what was expected, and the
        value.
    """
    try:
        return convert(document, prepared(kind), dec_hook=_read_value)
    except _NOT_CONVERTED:
        name, value, wrong = _innermost_wrong("", document, kind)
        raise refused(where, name, _description(value, wrong, {**_EXPECTED, **(expected or {})}), value) from None


def refused(where: str, name: str, expected: str, value: object) -> InputError:
    """Return the error of a field, or of the whole document where the name is empty."""
    return InputError(f"{where}: {name}{': ' if name else ''}expected {expected}, got {shown(value)}")


def present_fields(where: str, document: object) -> dict[str, Any]:
    """Return the fields of a document that are not null; InputError if it is not an object."""
    if not isinstance(document, dict):
        raise refused(where, "", "an object", document)
    return {name: value for name, value in document.items() if value is not None}


def check_schema(where: str, fields: Mapping[str, Any], known: int) -> None:
    """Raise an InputError for a document of another version of its schema; without ``schema`` it is accepted."""
    schema = fields.get("schema", known)
    if type(schema) is not int or schema != known:
        raise refused(where, "schema", f"{known}, the only one known to this version", schema)


def read_covariance(where: str, entry: object, axes: tuple[str, ...], field: str = "matrix") -> Float64:
    """Read a matrix (K, K) of the object ``covariance`` of a document, which must state the given K ``axes``.

    Raises
    ------
    InputError
        The axes or the shape differ, a number is not finite, or a variance is negative.
    """
    if not isinstance(entry, dict):
        raise refused(where, "covariance", "an object", entry)
    if entry.get("axes") != [*axes]:
        raise refused(where, "covariance.axes", ", ".join(axes), entry.get("axes"))
    return read_variances(where, f"covariance.{field}", entry.get(field), len(axes))


def read_variances(where: str, name: str, value: object, count: int) -> Float64:
    """Read the field ``name`` with a covariance of some ``count`` of unknowns; `InputError` as `read_covariance`."""
    matrix = _finite_array(value, (count, count))
    if matrix is None or (np.diag(matrix) < 0).any():
        raise refused(where, name, f"{count} rows of {count} finite numbers, no negative variance", value)
    return matrix


def _read_value(kind: Any, value: object) -> Float64 | Path:
    """Convert the value of a field that is annotated as an array or a path; ValueError with what was expected."""
    if kind is Path:
        return Path(convert(value, str))
    if isinstance(value, np.ndarray):
        return value
    array = _finite_array(value, kind.shape)
    if array is None:
        raise ValueError(f"{' rows of '.join(map(str, kind.shape))} finite numbers")
    if kind is Transform and not _is_rigid(array):
        raise ValueError("a rotation and a translation over 0 0 0 1")
    if kind is Transform and np.abs(array[:3, 3]).max() > _FARTHEST:
        raise ValueError(f"a translation of at most {_FARTHEST:g} m")
    if np.abs(array).max() > _LARGEST:
        raise ValueError(f"{' rows of '.join(map(str, kind.shape))} numbers of at most {_LARGEST:g} in magnitude")
    return array


def _finite_array(value: object, shape: tuple[int, ...]) -> Float64 | None:
    """Convert nested lists of finite numbers to an array; None for other values and other shapes."""
    try:
        array = np.array(convert(value, list[list[Number]] if len(shape) == 2 else list[Number]))
    except (*_NOT_CONVERTED, ValueError):  # ValueError: rows of several lengths
        return None
    return array if array.shape == shape else None


def _is_rigid(pose: Float64) -> bool:
    """Whether a matrix (4, 4) is a rotation and a translation above a row 0 0 0 1."""
    rotation = pose[:3, :3]
    with np.errstate(all="ignore"):
        off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    return bool(off <= _RIGID and np.linalg.det(rotation) > 0 and (pose[3] == [0, 0, 0, 1]).all())


def _innermost_wrong(name: str, value: object, kind: Any) -> tuple[str, object, Any]:
    """Find the innermost value that cannot be converted; return its name, the value and its declared type."""
    for part, inner, declared in _parts(value, kind):
        try:
            convert(inner, declared, dec_hook=_read_value)
        except _NOT_CONVERTED:
            return _innermost_wrong(f"{name}{part}", inner, declared)
    return name.removeprefix("."), value, kind


def _parts(value: object, kind: Any) -> list[tuple[str, object, Any]]:
    """List the values inside a value, each as the suffix of its name, the value and its declared type."""
    kind, _ = _unwrapped(kind)
    if get_origin(kind) is tuple and isinstance(value, list | tuple):
        return [(f"[{k}]", inner, get_args(kind)[0]) for k, inner in enumerate(value)]
    if not isinstance(value, dict):
        return []
    if get_origin(kind) is dict:
        return [(f".{shown(key)[1:-1]}", inner, get_args(kind)[1]) for key, inner in value.items()]
    from msgspec.inspect import type_info

    declared = getattr(type_info(kind), "fields", ())  # of dataclasses and structures
    hints = get_type_hints(kind, include_extras=True) if declared else {}
    return [
        (f".{field.encode_name}", value.get(field.encode_name), hints[field.name])
        for field in declared
        if field.required or field.encode_name in value
    ]


def _unwrapped(kind: Any) -> tuple[Any, str | None]:
    """Return a declared type without ``Annotated`` and ``| None``, and the description in its annotation."""
    description = None
    while get_origin(kind) in (Annotated, Union, UnionType):
        kind, *notes = get_args(kind)
        description = next((note.description for note in notes if isinstance(note, Meta)), description)
    return kind, description


def _description(value: object, kind: Any, names: Mapping[Any, str]) -> str:
    """Describe the values that a declared type accepts."""
    kind, description = _unwrapped(kind)
    if description is not None:
        return description
    if get_origin(kind) is Literal:
        return f"one of {', '.join(nearest_first(str(value)[:60], get_args(kind)))}"
    if hasattr(kind, "shape"):
        try:
            _read_value(kind, value)
        except ValueError as error:
            return str(error)
    return names.get(get_origin(kind) or kind, names[dict])
