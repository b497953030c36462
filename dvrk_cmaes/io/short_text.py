"""Format values for messages, on one line and short; find numbers, and order names by those in them: 10 after 9."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

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


def counted(number: int, what: str) -> str:
    """Format a number with a noun, in the plural unless the number is one: ``1 frame``, ``2 frames``."""
    return f"{number} {what}{'' if number == 1 else 's'}"


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
