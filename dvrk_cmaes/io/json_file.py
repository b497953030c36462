"""Read JSON files."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.short_text import shown

_LARGEST = 100_000_000  # bytes
# strings are matched so that comment marks within them are kept; ends are optional, so that time stays linear
_STRING_OR_COMMENT = re.compile(r'("(?:\\.|[^"\\])*(?:"|\Z))|//[^\n]*|/\*.*?(?:\*/|\Z)', re.DOTALL)


def read_json_object(path: str | Path, *, expected: str, comments: bool = False) -> dict[str, Any]:
    """Read a JSON file whose document is an object.

    Parameters
    ----------
    path
        The file.
    expected
        What the file should be, for messages.
    comments
        Whether comments as in C++ are allowed, which the dVRK's configuration files contain.

    Raises
    ------
    InputError
        The file is not readable, larger than 100 MB, not JSON, nested too deeply, or not an object.
    """
    document = read_json(path, expected=expected, comments=comments)
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected {expected}, got {shown(document)}")
    return document


def read_json(path: str | Path, *, expected: str, comments: bool = False) -> Any:
    """Read a JSON file of any document; parameters and errors as in ``read_json_object``."""
    text = read_text(path, expected=expected, largest=_LARGEST)
    try:
        return json.loads(_without_comments(text) if comments else text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected {expected}, got no valid JSON ({error})") from None


def _without_comments(text: str) -> str:
    """Replace comments by blanks; the numbers of lines do not change."""
    return _STRING_OR_COMMENT.sub(lambda match: match[1] or " " + "\n" * match[0].count("\n"), text)
