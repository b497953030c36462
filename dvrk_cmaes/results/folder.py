"""Read a folder of results: the output of a batch, or any folder of JSON files of results."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import in_order, no_folder, shown
from dvrk_cmaes.results.file import read_result
from dvrk_cmaes.results.followed import read_followed
from dvrk_cmaes.results.parts import data_frame, html_table
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.track_files import TRACKS

SUMMARY = "summary.json"
SESSION = "session.json"
ALONE = "alone"
"""Subfolder of a calibrated session's output with the results of its frames solved one by one."""

ARMS = "arms.json"
"""File of where the bases of several arms are relative to each other, in the folder of the arms' results."""

MANIFEST = "run.json"
"""File of what the results in a folder were made with."""

_NO_RESULTS = (SUMMARY, SESSION, ARMS, MANIFEST, "golden.json", "checkpoint.json")


@dataclass(frozen=True, eq=False)
class ResultsFolder:
    """Results by frame, sorted by name, and the documents of the session, None where there are none."""

    folder: Path
    frames: dict[str, Result]
    summary: dict[str, Any] | None
    session: dict[str, Any] | None

    def __repr__(self) -> str:
        """Show the folder and how many frames have each status."""
        counts = Counter(result.status for result in self.frames.values())
        return f"ResultsFolder({str(self.folder)!r}, {', '.join(f'{n} {status}' for status, n in counts.items())})"

    def _repr_html_(self) -> str:
        """Show frames, statuses, the 90 % range of the tips and reasons as a table in a notebook."""
        names = ("frame", "status", "tips_90_mm", "tip_probability", "iou", "reasons")
        return html_table([names, *([row[name] for name in names] for row in self.to_rows())])

    def to_rows(self) -> list[dict[str, Any]]:
        """Return the rows of poses.csv: a number, a text or None by column, with the unit in the column's name."""
        from dvrk_cmaes.results.pose_rows import pose_rows

        return pose_rows(self.frames.values())

    def to_frame(self) -> Any:
        """Return these rows as a pandas DataFrame.

        Raises
        ------
        InputError
            pandas is not installed.
        """
        return data_frame(self.to_rows())


def read_results(folder: str | Path, *, summary: bool = True) -> ResultsFolder:
    """Read the results in ``frames`` or, without such a subfolder, in the folder itself, and the session's documents.

    The frames of a recording that `track` followed (tracks.jsonl) are read as results, too. Without ``summary``,
    summary.json is not read.

    Parameters
    ----------
    folder
        The folder that a command wrote.
    summary
        Whether to read summary.json.

    Raises
    ------
    InputError
        The folder does not exist or has no results, or a file is no result; the message names the file.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"{folder}: {no_folder(folder)}; expected results, with frames/FRAME.json")
    if is_followed(root):
        session = _document(root / SESSION, "a session calibration (session.json)")
        return ResultsFolder(root, in_order(read_followed(root)), None, session)
    try:
        paths = result_paths(root)
    except OSError as error:
        raise InputError(f"{folder}: not readable ({error.strerror}); expected results") from None
    if not paths:
        raise InputError(f"{folder}: expected results, frames/FRAME.json or FRAME.json, got none")
    return ResultsFolder(
        folder=root,
        frames=_by_name(paths),
        summary=_document(root / SUMMARY, "the summary of a session's results (summary.json)") if summary else None,
        session=_document(root / SESSION, "a session calibration (session.json)"),
    )


def is_followed(folder: Path) -> bool:
    """Whether a folder has the frames of a followed recording, and no results of single frames."""
    return (folder / TRACKS).is_file() and not (folder / "frames").is_dir()


def folder_of_arm(folder: Path, arm: str) -> Path:
    """Return an arm's subfolder of a folder with the results of several arms; other paths as they are.

    Raises
    ------
    InputError
        The folder has results of other arms only.
    """
    if not folder.is_dir() or (folder / SESSION).exists() or result_paths(folder):
        return folder
    arms = sorted(
        each.name
        for each in folder.iterdir()
        if each.name != ALONE and ((each / "frames").is_dir() or (each / SESSION).is_file())
    )
    if arms and arm not in arms:
        raise InputError(f"{folder}: expected the results of arm {arm}, got those of {', '.join(arms)} (see --arm)")
    return folder / arm if arms else folder


def result_paths(root: Path) -> list[Path]:
    """List the result files of a folder, sorted by the names of the frames."""
    inner = root / "frames"
    source = inner if inner.is_dir() else root
    return sorted(
        path
        for path in source.iterdir()
        if path.suffix == ".json"
        and not path.name.startswith(".")
        and (source is inner or path.name not in _NO_RESULTS)
    )


def _by_name(paths: list[Path]) -> dict[str, Result]:
    results: dict[str, Result] = {}
    for path in paths:
        result = read_result(path)
        if result.frame in results:
            raise InputError(f"{path}: frame: expected a name of its own, got {shown(result.frame)}, as another file")
        results[result.frame] = result
    return in_order(results)


def _document(path: Path, expected: str) -> dict[str, Any] | None:
    return read_json_object(path, expected=expected) if os.path.lexists(path) else None
