"""Small YAML files from strangers: plain data only, and nothing that unfolds into more than was written.

OpenCV's dialect is read too: its first line ``%YAML:1.0`` is no directive that YAML knows, and its matrices are tagged.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.shown import shown

_LARGEST = 1_000_000  # bytes
_DEEPEST = 20  # mappings and lists within each other
_LONGEST = 1_000  # characters of a value; Python's integers take quadratic time to read
_MOST_ITEMS = 20_000  # PyYAML takes seconds for a megabyte of tiny items
_OPENCV_HEADER = re.compile(r"\A%YAML:[^\n]*")


class _Loader(yaml.SafeLoader):
    """A safe loader for which OpenCV's matrices are plain mappings."""


def _matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


for _tag in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _matrix)


def read_yaml_mapping(path: str | Path, *, expected: str) -> dict[str, Any]:
    """Read the first document of a YAML file, which must be a mapping; its keys as text.

    A topic dump ends in ``---`` and may hold message after message: only the first is read.

    Raises
    ------
    InputError
        Not readable, larger than 1 MB, not YAML, aliases, nested too deeply, or not a mapping.
    """
    text = _OPENCV_HEADER.sub("", read_text(path, expected=expected, largest=_LARGEST))
    try:
        _refuse_bombs(path, text)
        document = next(iter(yaml.load_all(text, Loader=_Loader)), None)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise InputError(f"{path}: expected {expected}, got no valid YAML ({line}{error.problem})") from None
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date or number that Python cannot hold
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: expected {expected}, got no valid YAML ({reason})") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected {expected}, got no mapping of names to values")
    return {str(key): value for key, value in document.items()}


def _refuse_bombs(path: str | Path, text: str) -> None:
    """Go through the events of the first document, which costs no memory, before anything is built."""
    depth = 0
    for items, event in enumerate(yaml.parse(text, Loader=yaml.SafeLoader)):
        if isinstance(event, yaml.DocumentEndEvent):
            return
        if isinstance(event, yaml.AliasEvent):
            raise InputError(f"{path}: expected plain values, got a YAML alias ({shown(event.anchor)})")
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > _LONGEST:
            raise InputError(f"{path}: expected a small file, got a YAML value of {len(event.value)} characters")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST or items > _MOST_ITEMS:
            limit = f"{_DEEPEST} levels" if depth > _DEEPEST else f"{_MOST_ITEMS} items"
            raise InputError(f"{path}: expected a small file, got YAML of more than {limit}")
