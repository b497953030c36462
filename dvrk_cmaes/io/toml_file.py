"""Settings from a TOML file: its tables and keys are the fields of a tree of dataclasses, and nothing else.

seed = 3
[search]
samples = 1024
[refine.outline]
blur = 1.0
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.short_text import shown

T = TypeVar("T")

_LARGEST = 1_000_000  # bytes
_MOST_DOTS = 100  # in a key or a value: tomllib takes memory with the square of a key's parts
_SUGGESTED = 3
_KINDS: dict[type, str] = {bool: "true or false", int: "a whole number", float: "a number", str: "text in quotes"}


def read_config(path: str | Path, default: T) -> T:
    """Read a TOML file over a tree of dataclasses; what the file does not name stays as it is in ``default``.

    Raises
    ------
    InputError
        Not a TOML file, an unknown key (with the nearest known ones), or a value of another type.
    """
    text = read_text(path, expected="settings (TOML)", largest=_LARGEST)
    if any(part.count(".") > _MOST_DOTS for part in re.split(r"[=\n]", text)):
        raise InputError(f"{path}: expected settings (TOML), got a key of more than {_MOST_DOTS} parts")
    import tomllib

    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: also a whole number that Python will not read
        raise InputError(f"{path}: expected settings (TOML), got no valid TOML: {error}") from None
    return updated(default, document, where=str(path))


def updated(default: T, values: Mapping[str, Any], *, where: str) -> T:
    """Replace fields of a tree of dataclasses by the values of a tree of mappings; errors as in ``read_config``."""
    return _updated(default, values, where, "", [key for key, _ in leaves(default)])


def _updated(default: T, values: Mapping[str, Any], where: str, table: str, known: list[str]) -> T:
    changes = {}
    for name, value in values.items():
        key = f"{table}{name}"
        if name not in {field.name for field in fields(default)}:  # type: ignore[arg-type]
            near = ", ".join(nearest_first(key, known)[:_SUGGESTED])
            raise InputError(f"{where}: unknown key {key}; the nearest known are {near}")
        current = getattr(default, name)
        if is_dataclass(current) and not isinstance(current, type):
            if not isinstance(value, Mapping):
                raise InputError(f"{where}: {key}: expected a table, got {shown(value)}")
            changes[name] = _updated(current, value, where, f"{key}.", known)
        else:
            changes[name] = _checked(value, type(current), f"{where}: {key}")
    return replace(default, **changes)  # type: ignore[type-var]


def leaves(tree: Any, table: str = "") -> Iterator[tuple[str, Any]]:
    """All settings of a tree of dataclasses, as ``table.key`` and value."""
    for field in fields(tree):
        value = getattr(tree, field.name)
        if is_dataclass(value):
            yield from leaves(value, f"{table}{field.name}.")
        else:
            yield f"{table}{field.name}", value


def _checked(value: Any, kind: type, where: str) -> Any:
    """Value of a key, if it is of the field's type; a whole number will do for a float."""
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not kind:
        raise InputError(f"{where}: expected {_KINDS[kind]}, got {shown(value)}")
    return value
