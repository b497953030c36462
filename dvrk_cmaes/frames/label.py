"""Labels that select an instrument's pixels in a mask: values, colours, or everything but the background.

A label is written as a number (``1``), several (``10,20,30``, the parts of one instrument), a colour (``#00ff00``), or
``any``, for all values but zero. In masks as JSON, it is the number or the name of a category.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.io.short_text import shown

Label = tuple[int | str, ...]
"""Values, colours ``#rrggbb``, ``any`` and names of categories, each of which selects pixels."""

LabelText = int | str | Sequence[int | str]
"""A label as it is given: a number, a text, or a list of these."""

ANY = "any"
EXPECTED = "a value of a mask, 0 to 65535, several (10,20,30), a colour (#00ff00), or any for all but 0"

_COLOUR = re.compile(r"#[0-9a-f]{6}")
_NAME = re.compile(r"[A-Za-z_][\w .-]*")  # of a category of COCO's
_LARGEST = 65535
_MOST_NAMED = 8


def parse_label(where: str, given: LabelText) -> Label:
    """Parse a label; InputError, which begins with ``where``, if it is not one."""
    if isinstance(given, str):
        parts: Iterable[object] = given.split(",")
    else:
        parts = given if isinstance(given, Sequence) else [given]
    return tuple(dict.fromkeys(_parsed(where, part) for part in parts))


def _parsed(where: str, part: object) -> int | str:
    """Parse a value, a colour or ``any``."""
    if isinstance(part, bool) or not isinstance(part, int | str):
        raise InputError(f"{where}: expected {EXPECTED}, got {shown(part)}")
    text = str(part).strip().lower()
    if text == ANY or _COLOUR.fullmatch(text):
        return text
    if text.isascii() and text.isdigit() and int(text) <= _LARGEST:
        return int(text)
    if _NAME.fullmatch(str(part).strip()):
        return str(part).strip()
    raise InputError(f"{where}: expected {EXPECTED}, got {shown(part)}")


def selected(values: NDArray[np.integer], label: Label) -> Bool:
    """Return the pixels (H, W) of values (H, W), or of colours (H, W, 3), BGR, that a label selects."""
    mask = np.zeros(values.shape[:2], np.bool_)
    for part in label:
        if part == ANY:
            mask |= (values != 0) if values.ndim == 2 else values.any(axis=2)
        elif isinstance(part, str):
            mask |= (values == [int(part[k : k + 2], 16) for k in (5, 3, 1)]).all(axis=2)
        else:
            mask |= values == part
    return mask


def named(values: NDArray[np.integer]) -> str:
    """List the values (H, W), or the most frequent colours (H, W, 3), BGR, of an image."""
    if values.ndim == 2:
        found = [str(value) for value in np.unique(values)]
    else:
        packed = values.astype(np.uint32) @ np.array([1, 256, 65536], np.uint32)
        colours, counts = np.unique(packed, return_counts=True)
        found = [f"#{colour:06x}" for colour in colours[np.argsort(-counts, kind="stable")]]
    return ", ".join(found[:_MOST_NAMED]) + (", ..." if len(found) > _MOST_NAMED else "")
