"""The output folder of a batch: the frames of it, complete results, and writing."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Sequence
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.calibration.document import read_calibration
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.frames.frame import FrameFiles, readable
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import listed, natural, shown
from dvrk_cmaes.results.file import read_result
from dvrk_cmaes.results.folder import SESSION, SUMMARY
from dvrk_cmaes.results.paths import check_output, mask_path, overlay_path, result_path
from dvrk_cmaes.results.result import Status
from dvrk_cmaes.runs.manifest import ADVICE

_LONGEST_NAME = 255  # bytes, the limit of nearly all file systems


def chosen_frames(frames: Sequence[FrameFiles], pattern: str | None) -> tuple[FrameFiles, ...]:
    """Return the frames whose names match a shell pattern (``*``, ``?``, ``[..]``), or all frames, in order.

    The name of a frame, with brackets in it, too, is a pattern of this frame alone.

    Raises
    ------
    InputError
        No frame matches.
    """
    named = [frame for frame in frames if frame.name == pattern]
    matching = named or [frame for frame in frames if pattern is None or fnmatchcase(frame.name, pattern)]
    chosen = tuple(sorted(matching, key=lambda frame: natural(frame.name)))
    if not chosen:
        near = listed(nearest_first(str(pattern), [frame.name for frame in frames[:1000]]))
        raise InputError(f"--frames: expected a pattern of some of the {len(frames)} frames ({near}), got {pattern!r}")
    return chosen


def check_names(out: Path, frames: Sequence[FrameFiles]) -> None:
    """Check that the results of all frames can be written to a folder.

    Raises
    ------
    InputError
        As `check_output`; or a file name would be too long.
    """
    for frame in frames:
        check_output(out, frame.name)
        name = result_path(out, frame.name).name
        if len(os.fsencode(name)) > _LONGEST_NAME:
            raise InputError(
                f"frame: expected a name of at most {_LONGEST_NAME} bytes with .json, got {shown(frame.name)}"
            )


COMMAND: Final = "batch"
POSES: Final = "poses.csv"
PAGE: Final = "report.html"
TABLES: Final = (POSES, SUMMARY, PAGE)
"""Files of all frames together."""


def results_of(frames: Iterable[str], views: Iterable[str]) -> list[str]:
    """Return the paths, in the folder, of all files that frames with views of some names may have."""
    here, names = Path(), list(views)
    return [
        path.as_posix()
        for frame in frames
        for path in (
            result_path(here, frame),
            overlay_path(here, frame),
            *(mask_path(here, frame, view) for view in (names if len(names) > 1 else ("",))),
        )
    ]


def earlier_results(out: Path, chosen: Collection[str], session: Collection[str]) -> dict[str, Status]:
    """Return the status of each frame that has a valid result in a folder and, unless it failed, an overlay.

    Raises
    ------
    InputError
        A result is not of one of the session's frames, or it is damaged and not among the chosen frames, which are
        estimated again; or the folder has a calibration that is damaged.
    """
    paths = {path.stem: path for path in sorted((out / "frames").glob("*.json"), key=lambda path: natural(path.name))}
    missing = [name for name in paths if name not in session]
    if missing:
        raise InputError(f"{out}: it has results of frames that are not in the session: {listed(missing)}: {ADVICE}")
    found: dict[str, Status] = {}
    for name, path in paths.items():
        result = readable(partial(read_result, path)) if name in chosen else read_result(path)
        complete = result is not None and (result.status == "failed" or overlay_path(out, name).is_file())
        if result is not None and complete and result.frame == name:
            found[name] = result.status
    if (out / SESSION).exists():
        read_calibration(out / SESSION)
    return found


def update_result(out: Path, name: str, **fields: Any) -> None:
    """Replace fields of a result that is there."""
    path = result_path(out, name)
    write_json(path, {**read_json_object(path, expected="a result"), **fields})
