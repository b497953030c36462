"""JSON files from strangers: one object, read whole, or one line that says why not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.shown import shown

_LARGEST = 100_000_000  # bytes


def read_json_object(path: str | Path, *, expected: str) -> dict[str, Any]:
    """Read a JSON file whose document is an object; ``expected`` says for messages what the file should be.

    Raises
    ------
    InputError
        Not readable, larger than 100 MB, not JSON, nested too deeply, or not an object.
    """
    try:
        document = json.loads(read_text(path, expected=expected, largest=_LARGEST))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected {expected}, got no valid JSON ({error})") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected {expected}, got {shown(document)}")
    return document
