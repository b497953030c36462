"""Format values for messages, on one line and short; find numbers, and order names by those in them: 10 after 9.

Check the arguments of public functions, so that a wrong one is named in one line.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool

_LONGEST = 60
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
"""Control characters, and those that turn the direction of a text."""


def shown(value: Any) -> str:
    """Format a value as Python's ``repr``, shortened to 60 characters; None as ``nothing``."""
    if value is None:
        return "nothing"
    try:
        text = repr(value[: 2 * _LONGEST] if isinstance(value, str) else value)
    except (ValueError, RecursionError):  # an integer of more digits than Python prints; too many levels
        return f"a value of type {type(value).__name__} that is too large to show"
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."


def escaped(text: str) -> str:
    """Return a text whose control characters and bytes that are no UTF-8 are escaped, as of a file's name."""
    text = _CONTROL.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)
    return text.encode("utf-8", errors="backslashreplace").decode("utf-8")


def listed(names: Iterable[str], most: int = 5) -> str:
    """List the first names, separated by commas, each shortened as by ``shown``."""
    names = list(names)
    first = [shown(name)[1:-1] for name in names[:most]]
    return ", ".join(first) + (", ..." if len(names) > most else "")


def is_number(text: str) -> bool:
    """Whether a text is a number, NaN included."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def no_folder(path: str | Path) -> str:
    """Say what is at a path where a folder was expected: nothing, or a file."""
    return "a file" if Path(path).exists() else "no such folder"


T = TypeVar("T")

_NUMBER = re.compile(r"([0-9]+)")


def natural(name: str) -> tuple[list[str | int], str]:
    """Return the key that sorts names by the numbers in them, and those of equal numbers as texts."""
    parts = _NUMBER.split(name)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], name


def in_order(values: Mapping[str, T]) -> dict[str, T]:
    """Return values in the order of their names, as by `natural`."""
    return {name: values[name] for name in sorted(values, key=natural)}


PATH = (str, os.PathLike)


def check_type(name: str, value: object, kinds: type | tuple[type, ...], expected: str) -> None:
    """Raise an InputError, which names the argument and what was expected, for a value of none of the types."""
    if not isinstance(value, kinds):
        raise InputError(f"{name}: expected {expected}, got {described(value)}")


def checked_number(name: str, value: object, expected: str) -> float:
    """Return a real number, finite or not, as a float; InputError, which names the argument, for anything else."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"{name}: expected {expected}, got {described(value)}")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{name}: expected {expected}, got {described(value)}") from None


def checked_array(name: str, value: object, dtype: type, expected: str, dimensions: int | None = None) -> NDArray[Any]:
    """Convert numbers to an array of a type; InputError, which names the argument, for paths, texts and ragged lists.

    ``dimensions`` is the number of axes that it must have.
    """
    try:
        array = None if isinstance(value, (*PATH, dict, bytes)) else np.asarray(value)
        if array is not None and array.dtype.kind in "biuf" and dimensions in (None, array.ndim):
            return array.astype(dtype, copy=False)
    except (ValueError, TypeError):
        pass
    raise InputError(f"{name}: expected {expected}, got {described(value)}")


def checked_mask(name: str, value: object) -> Bool:
    """Return a mask (H, W) as bool; InputError, which names the argument, for anything else, such as an image.

    An array of numbers may have two values, of which the one that is not zero is instrument.
    """
    flags = checked_array(name, value, np.bool_, "an array (H, W) of bool", dimensions=2)
    given = np.asarray(value)
    if given.dtype.kind == "f" and not np.isfinite(given).all():
        raise InputError(f"{name}: expected bool, or two values, got {given.dtype} with values that are not finite")
    if given.dtype != np.bool_ and len(levels := np.unique(given)) > 2:
        raise InputError(
            f"{name}: expected bool, or two values, got {given.dtype} with {len(levels)} values, as of "
            "an image; a mask that was read is compared first: mask > 127"
        )
    return flags


def described(value: object) -> str:
    """Describe a value for a message: an array by its shape, text, paths, numbers and None as they are, or its type."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if value is None or isinstance(value, (*PATH, int, float)):
        return shown(value if value is None or isinstance(value, int | float) else str(value))
    return f"a value of type {type(value).__name__}"
