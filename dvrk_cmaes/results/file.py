"""Read the JSON file of a frame's result, as written by this or another program."""

from __future__ import annotations

from pathlib import Path

from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.results.result import Result

_EXPECTED = "a frame's result (JSON)"


def read_result(path: str | Path) -> Result:
    """Read a result; a frame without a name in the document gets the name of the file.

    Parameters
    ----------
    path
        The file, as ``frames/FRAME.json``.

    Raises
    ------
    InputError
        The file is not readable or no JSON object, or as in `Result.from_dict`; the message names file and field.
    """
    document = read_json_object(path, expected=_EXPECTED)
    if document.get("frame") is None:
        document["frame"] = Path(path).stem
    return Result.from_dict(document, where=str(path))
