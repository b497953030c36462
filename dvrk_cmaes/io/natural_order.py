"""Order of names with numbers in them: by number, not by digit, so that 10 comes after 9."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TypeVar

T = TypeVar("T")

_NUMBER = re.compile(r"([0-9]+)")


def natural(name: str) -> tuple[list[str | int], str]:
    """Return the key that sorts names by the numbers in them, and those of equal numbers as texts."""
    parts = _NUMBER.split(name)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], name


def in_order(values: Mapping[str, T]) -> dict[str, T]:
    """Return values in the order of their names, as by `natural`."""
    return {name: values[name] for name in sorted(values, key=natural)}
