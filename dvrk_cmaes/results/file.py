"""A frame's result, read from the JSON that ``estimate`` or another program wrote."""

from __future__ import annotations

from pathlib import Path

from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.results.result import Result

_EXPECTED = "a frame's result (JSON)"


def read_result(path: str | Path) -> Result:
    """Read a result; the frame is named as the file where the document does not name it.

    Raises
    ------
    InputError
        Not readable, no JSON object, or as `Result.from_dict`; the message names the file and the field.
    """
    document = read_json_object(path, expected=_EXPECTED)
    if document.get("frame") is None:
        document["frame"] = Path(path).stem
    return Result.from_dict(document, where=str(path))
