"""Check the arguments of public functions, so that a wrong one is named in one line."""

from __future__ import annotations

import os
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.io.short_text import shown

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
