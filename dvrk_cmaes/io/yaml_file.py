"""Read and write small YAML files of plain data.

Aliases are refused, since they can expand to more than memory holds.

OpenCV's dialect is accepted: its first line ``%YAML:1.0``, or ``%YAML 1.0``, is no directive of today's YAML, and its
matrices are tagged.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import yaml

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.short_text import shown

_LARGEST = 1_000_000  # bytes
_DEEPEST = 20  # nested mappings and lists
_LONGEST = 1_000  # characters of a value; the time to parse an integer grows with the square of its length
_MOST_ITEMS = 20_000  # PyYAML takes seconds for a megabyte of tiny items
_MOST_DOCUMENTS = 200_000
_LARGEST_TABLE = 20_000_000  # bytes, of a file of values by frame
_MOST_TABLE_ITEMS = 400_000  # at most 170 MB of memory while they are parsed
_OPENCV_HEADER = re.compile(r"\A\s*%YAML[: ][^\n]*")


_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, but not in every build of PyYAML
_MatrixLoader: Any = type("_MatrixLoader", (_Loader,), {})  # constructs OpenCV's matrices as mappings


def _matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


for _tag in ("opencv-matrix", "opencv-nd-matrix"):
    _MatrixLoader.add_constructor(f"tag:yaml.org,2002:{_tag}", _matrix)


def read_yaml_mapping(path: str | Path, *, expected: str) -> dict[str, Any]:
    """Read the first document of a YAML file, which must be a mapping; keys are converted to text.

    Further documents, such as the later messages of a topic dump, are not read.

    Raises
    ------
    InputError
        The file is not readable, larger than 1 MB, not YAML, has aliases, is nested too deeply, or is no mapping.
    """
    text = _OPENCV_HEADER.sub("", read_text(path, expected=expected, largest=_LARGEST))
    return _mapping(path, next(_documents(path, text, expected, _MatrixLoader, most=1), None), expected)


def read_yaml_by_frame(path: str | Path, *, expected: str) -> Any:
    """Read the first document of a YAML file with values of many frames, for which ``read_yaml_mapping`` is too small.

    Returns
    -------
    dict or list
        The document as plain values: a mapping, whose keys are not converted, or a list.

    Raises
    ------
    InputError
        The file is not readable, larger than 20 MB, of more than 400,000 values, not YAML, has aliases, is nested too
        deeply, or is neither a mapping nor a list.
    """
    text = read_text(path, expected=expected, largest=_LARGEST_TABLE)
    document = next(_documents(path, text, expected, _Loader, most=1, most_items=_MOST_TABLE_ITEMS), None)
    if not isinstance(document, dict | list):
        raise InputError(f"{path}: expected {expected}, got {shown(document)}")
    return document


def yaml_documents(path: str | Path, text: str, *, expected: str) -> list[dict[str, Any]]:
    """Return the documents of a text, each of which must be a small mapping or empty; empty ones are omitted.

    Raises
    ------
    InputError
        The text is not YAML or has aliases; a document is nested too deeply, too large, or no mapping.
    """
    documents = _documents(path, text, expected, _Loader, most=_MOST_DOCUMENTS)
    return [_mapping(path, document, expected) for document in documents if document is not None]


def _mapping(path: str | Path, document: object, expected: str) -> dict[str, Any]:
    """Return a document with texts as keys; InputError if it is not a mapping."""
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected {expected}, got no mapping of names to values")
    return {str(key): value for key, value in document.items()}


def check_yaml(path: str | Path, *, expected: str, longest: int = _LONGEST) -> None:
    """Raise the errors of ``read_yaml_mapping`` for a file that a library will read.

    ``longest`` is the largest number of characters of a value.
    """
    text = read_text(path, expected=expected, largest=_LARGEST)
    with _errors_as_input_errors(path, expected):
        _check_events(path, text, _Loader, _MOST_DOCUMENTS, longest)


def yaml_text(document: Mapping[str, Any]) -> str:
    """Format a mapping as the text of a YAML file, in its order, with lists of numbers on one line."""
    text: str = yaml.safe_dump(dict(document), sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
    return text


def _documents(
    path: str | Path, text: str, expected: str, loader: Any, *, most: int, most_items: int = _MOST_ITEMS
) -> Iterator[Any]:
    """Construct the first ``most`` documents of a text after their events have been checked."""
    with _errors_as_input_errors(path, expected):
        _check_events(path, text, loader, most, most_items=most_items)
        yield from islice(yaml.load_all(text, Loader=loader), most)


@contextmanager
def _errors_as_input_errors(path: str | Path, expected: str) -> Iterator[None]:
    """Convert the errors of PyYAML to InputError."""
    try:
        yield
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise InputError(f"{path}: expected {expected}, got no valid YAML ({line}{error.problem})") from None
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date or number outside Python's range
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: expected {expected}, got no valid YAML ({reason})") from None


def _check_events(
    path: str | Path, text: str, loader: Any, most: int, longest: int = _LONGEST, most_items: int = _MOST_ITEMS
) -> None:
    """Raise an InputError for aliases and for too many or too deep values; only parsing events are held in memory."""
    depth = items = documents = 0
    for event in yaml.parse(text, Loader=loader):
        items += 1
        if isinstance(event, yaml.DocumentEndEvent):
            items, documents = 0, documents + 1
            if documents == most:
                return
        if isinstance(event, yaml.AliasEvent):
            raise InputError(f"{path}: expected plain values, got a YAML alias ({shown(event.anchor)})")
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > longest:
            raise InputError(f"{path}: expected a small file, got a YAML value of {len(event.value)} characters")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST or items > most_items:
            limit = f"{_DEEPEST} levels" if depth > _DEEPEST else f"{most_items} items"
            raise InputError(f"{path}: expected a small file, got YAML of more than {limit}")
