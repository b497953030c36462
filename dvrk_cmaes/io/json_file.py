"""JSON files from strangers: one object, read whole, or one line that says why not."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.short_text import shown

_LARGEST = 100_000_000  # bytes
# strings, to leave alone what looks like a comment in them; both may lack their end, lest it is looked for again
_STRING_OR_COMMENT = re.compile(r'("(?:\\.|[^"\\])*(?:"|\Z))|//[^\n]*|/\*.*?(?:\*/|\Z)', re.DOTALL)


def read_json_object(path: str | Path, *, expected: str, comments: bool = False) -> dict[str, Any]:
    """Read a JSON file whose document is an object; ``expected`` says for messages what the file should be.

    ``comments``: those of C++ are passed over, as the dVRK's configuration files have them.

    Raises
    ------
    InputError
        Not readable, larger than 100 MB, not JSON, nested too deeply, or not an object.
    """
    text = read_text(path, expected=expected, largest=_LARGEST)
    try:
        document = json.loads(_without_comments(text) if comments else text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected {expected}, got no valid JSON ({error})") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected {expected}, got {shown(document)}")
    return document


def _without_comments(text: str) -> str:
    """Text with its comments blanked; lines keep their numbers."""
    return _STRING_OR_COMMENT.sub(lambda match: match[1] or " " + "\n" * match[0].count("\n"), text)
