"""Read TOML files: any, or settings, whose tables and keys are the fields of a tree of dataclasses.

Example::

    seed = 3
    [search]
    samples = 1024
    [refine.outline]
    blur = 1.0
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from dvrk_cmaes.config import REMOVED
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.io.typed_document import convert_document, refused

T = TypeVar("T")

_LARGEST = 1_000_000  # bytes
_MOST_PARTS = 20  # of a key; the memory that tomllib needs grows with their square
_QUOTED = re.compile(r'"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'')
_BETWEEN = re.compile(r"[=\n,{}\[\]]")  # what separates keys and values
_SUGGESTED = 3
_CLOSE = 0.75  # similarity from which a known name is probably the one that was meant
_LARGEST_INTEGER = 2**63 - 1  # of TOML
_EXPECTED = {str: "text in quotes", dict: "a table"}


def read_config(path: str | Path, default: T) -> T:
    """Read a TOML file into a tree of dataclasses; settings that are not in the file keep their value in ``default``.

    Raises
    ------
    InputError
        The file is no TOML file, has an unknown key (the nearest known are named), or a value of another type.
    """
    return updated(default, read_toml(path, expected="settings (TOML)"), where=str(path))


def read_toml(path: str | Path, *, expected: str) -> dict[str, Any]:
    """Read a TOML file; InputError if it is not readable, larger than 1 MB, no TOML, or has a key of over 20 parts."""
    text = read_text(path, expected=expected, largest=_LARGEST)
    if any(part.count(".") >= _MOST_PARTS for part in _BETWEEN.split(_QUOTED.sub("", text))):
        raise InputError(f"{path}: expected {expected}, got a key of more than {_MOST_PARTS} parts")
    import tomllib

    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: also an integer of too many digits
        raise InputError(f"{path}: expected {expected}, got no valid TOML: {error}") from None


def updated(default: T, values: Mapping[str, Any], *, where: str) -> T:
    """Replace fields of a tree of dataclasses by the values of a tree of mappings; errors as in ``read_config``."""
    known = [key for key, _ in leaves(default)]
    tree = _merged(asdict(default), values, where, "", known)  # type: ignore[call-overload]
    return convert_document(where, tree, type(default), _EXPECTED)


def _merged(tree: Mapping[str, Any], values: Mapping[str, Any], where: str, table: str, known: list[str]) -> Any:
    """Replace values of a tree of mappings; InputError for a key that it does not have."""
    merged = dict(tree)
    for name, value in values.items():
        key = f"{table}{name}"
        if name not in tree:
            if key in REMOVED:
                raise InputError(f"{where}: {key} is no longer a setting: {REMOVED[key]}")
            close = get_close_matches(key, known, n=_SUGGESTED, cutoff=_CLOSE)
            near = close or nearest_first(key, known)[:_SUGGESTED]
            verb = "is" if len(near) == 1 else "are"
            raise InputError(f"{where}: unknown key {shown(key)[1:-1]}; the nearest known {verb} {', '.join(near)}")
        if isinstance(tree[name], dict) and isinstance(value, Mapping):
            value = _merged(tree[name], value, where, f"{key}.", known)
        elif type(tree[name]) is int and isinstance(value, int) and abs(value) > _LARGEST_INTEGER:
            raise refused(where, key, "a whole number of at most 64 bits", value)
        merged[name] = value
    return merged


def leaves(tree: Any, table: str = "") -> Iterator[tuple[str, Any]]:
    """Yield all settings of a tree of dataclasses as ``table.key`` and value."""
    for field in fields(tree):
        value = getattr(tree, field.name)
        if is_dataclass(value):
            yield from leaves(value, f"{table}{field.name}.")
        else:
            yield f"{table}{field.name}", value
