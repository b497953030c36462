"""Read a folder of results: the output of a batch, or any folder of JSON files of results.

Read the JSON file of a frame's result, as written by this or another program.

Paths of the output of a frame: ``OUT/frames/<frame>.json`` and ``OUT/overlays/<frame>.jpg``.

A mask segmented from the image is written to ``OUT/masks/<frame>.png``; the overlay of the pose that the other frames
of a calibrated session predict, to ``OUT/overlays_left_out/<frame>.jpg``.
"""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.arguments import PATH, check_type
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import in_order, no_folder, shown
from dvrk_cmaes.results.followed import read_followed
from dvrk_cmaes.results.parts import data_frame, html_table
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TRACKS

SUMMARY = "summary.json"
SESSION = "session.json"
ALONE = "alone"
"""Subfolder of a calibrated session's output with the results of its frames solved one by one."""

ARMS = "arms.json"
"""File of where the bases of several arms are relative to each other, in the folder of the arms' results."""

MANIFEST = "run.json"
"""File of what the results in a folder were made with."""

_LONGEST_NAME = 250  # bytes of a frame's name: nearly all file systems allow 255, with .json
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
    check_type("folder", folder, PATH, "the path of a folder of results")
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
    document = read_json_object(path, expected="a frame's result (JSON)")
    if document.get("frame") is None:
        document["frame"] = Path(path).stem
    return Result.from_dict(document, where=str(path))


def result_path(out: Path, frame: str) -> Path:
    """Return the path of a frame's result."""
    return out / "frames" / f"{frame}.json"


def overlay_path(out: Path, frame: str) -> Path:
    """Return the path of a frame's overlay."""
    return out / "overlays" / f"{frame}.jpg"


def left_out_path(out: Path, frame: str) -> Path:
    """Return the path of the overlay of the pose that the session's other frames predict."""
    return out / "overlays_left_out" / f"{frame}.jpg"


def mask_path(out: Path, frame: str, view: str = "") -> Path:
    """Return the path of the mask that was found in the image of a frame, or in that of one of its views."""
    return out / "masks" / view / f"{frame}.png"


def check_frame_name(frame: str) -> None:
    """Raise an InputError for the name of a frame that is not valid as the name of a file."""
    valid = frame and frame.isprintable() and not ("/" in frame or os.sep in frame or frame.startswith("."))
    if not valid or len(os.fsencode(frame)) > _LONGEST_NAME:
        rules = f"no slash, no leading dot, at most {_LONGEST_NAME} bytes"
        raise InputError(f"frame: expected a name that can be a file's ({rules}), got {shown(frame)}")


def found_masks(out: Path, frame: str) -> list[Path]:
    """Return the paths of the masks in a folder that were found in the images of a frame, of all its views."""
    masks = mask_path(out, frame).parent
    views = sorted(path for path in masks.iterdir() if path.is_dir()) if masks.is_dir() else []
    return [path for folder in (masks, *views) if (path := folder / f"{frame}.png").exists()]


def check_output(out: Path, frame: str) -> None:
    """Check that the files of a frame can be written, before they are computed.

    Raises
    ------
    InputError
        The name is not valid for a file, a file has the path of the folder, or the folder is not writable.
    """
    check_frame_name(frame)
    for folder in (result_path(out, frame).parent, overlay_path(out, frame).parent):
        check_writable(folder, named=out)


def check_writable(folder: Path, *, named: Path | None = None) -> None:
    """Raise an InputError for a folder that cannot be created or written to; ``named`` is its path in messages."""
    name = folder if named is None else named
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.exists(path))
    if not there.is_dir():
        raise InputError(f"{name}: expected a folder to write to, but {there} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{name}: expected a folder to write to, but {there} may not be written to")
