"""Who owns an output folder: what an earlier run wrote there may be replaced, what anybody else put there may not.

A run writes only to a folder that does not exist, is empty, or was written by a run of the same command; other files in
it are left alone. A command that puts a new folder in the place of the old one asks for a folder without other files.
OUT/run.json tells that a batch, a calibration or a followed recording wrote there. Where masks were written,
OUT/.written.json names the command and has their digests, so that a mask which was corrected by hand since is known as
the user's.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final, Literal

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.atomic import places_to_write, write_json
from dvrk_cmaes.io.files import file_digest
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.written_files import RECORD, Written, files_in, read_written, write_written
from dvrk_cmaes.results.folder import ALONE, MANIFEST
from dvrk_cmaes.results.track_files import TRACKS

Command = Literal["batch", "calibrate", "segment", "track"]

_MASKS: Final = r"masks/(?:[^/]+/)?[^/]+\.png"
_WRITES: Final[dict[str, str]] = {
    "calibrate": rf"(?:frames|layers)/[^/]+\.json|(?:overlays|overlays_left_out)/[^/]+\.jpg|{_MASKS}|alone/.*|"
    r"(?:camera|left|right)\.yaml|poses\.csv|summary\.json|session\.json|report\.html|run\.json",
    "segment": rf"{_MASKS}|scores/(?:[^/]+/)?[^/]+\.png|overlays/(?:[^/]+/)?[^/]+\.jpg",
}
"""What a command writes that puts a new folder in the place of the old one."""

_BEGUN: Final = {f"{ALONE}/frames": "calibrate", "shards": "batch", "lag/frames": "batch", "session": "track"}
"""Folders that commands write before run.json is there."""


def check_owned(out: Path, command: Command, *, replaces: bool = False) -> None:
    """Check, before any work, that a command may write to a folder.

    Parameters
    ----------
    out
        The folder. Links and ``..`` are followed.
    command
        The command.
    replaces
        Whether it replaces files that are there, and does not only add to them.

    Raises
    ------
    InputError
        The folder has a file that no run of the command wrote, or, if it is to be replaced, that was changed since.
    """
    target = Path(os.path.realpath(out))
    if not target.is_dir():
        return
    files = list(files_in(target))
    if not files:
        return
    record = _record(target)
    if record is None:
        raise InputError(
            f"{out}: expected a new or empty folder, or one of an earlier {command}, got one with {files[0]}; nothing "
            "was changed"
        )
    if record.command != command:
        raise InputError(f"{out}: it has what `{record.command}` wrote, which stays as it is; choose another --out")
    for name in files if command in _WRITES else ():
        if not re.fullmatch(_WRITES[command], name):
            raise InputError(f"{out}: {name} was not written by `{command}`; choose another --out, or move it")
    for name in record.files if replaces else ():
        if record.is_changed(target, name):
            raise InputError(f"{out}: {name} was changed since it was written; choose another --out, or move it")


def check_frame_files(out: Path, names: Iterable[Path]) -> None:
    """Check, before any work, that `estimate` may write files to a folder to which it may have written others.

    Raises
    ------
    InputError
        Another command has noted what it wrote there, or a file is there that `estimate` did not write, or that was
        changed since, or the folder cannot be written to.
    """
    with places_to_write(out, "a folder"):
        folder = Path(os.path.realpath(out))
        record = _estimated(out)
        for path in names:
            name = path.relative_to(out).as_posix()
            if os.path.lexists(folder / name) and (name not in record.files or record.is_changed(folder, name)):
                raise InputError(f"{out}: {name} was not written by `estimate`, or changed since; choose another --out")


def record_frame_files(out: Path, paths: Iterable[Path]) -> None:
    """Note files that `estimate` has written beside those that it wrote before."""
    added = {path.relative_to(out).as_posix(): file_digest(path) for path in paths}
    files = {**_estimated(out).files, **added}
    write_json(out / RECORD, {"command": "estimate", "files": dict(sorted(files.items()))})


def _estimated(out: Path) -> Written:
    """Return what `estimate` wrote to a folder; InputError if that is noted of another command."""
    record = read_written(out) or Written("estimate")
    if record.command != "estimate":
        raise InputError(f"{out}: it has what `{record.command}` wrote, which stays as it is; choose another --out")
    return record


def record_masks(out: Path, command: Command) -> None:
    """Note the masks in a folder, which a command has written, with their digests; nothing if there are none.

    Errors as in `dvrk_cmaes.io.atomic.write_json`.
    """
    masks = [name for name in files_in(out) if re.fullmatch(_MASKS, name)]
    if masks:
        write_written(out, command, masks)


def _record(folder: Path) -> Written | None:
    """Return what is known of the run that wrote to a folder; None if nothing is."""
    if (written := read_written(folder)) is not None:
        return written
    if not (folder / MANIFEST).is_file():
        return next((Written(command) for part, command in _BEGUN.items() if (folder / part).is_dir()), None)
    manifest = read_json_object(folder / MANIFEST, expected="what a run was made with (run.json)")
    if "track" in manifest or (folder / TRACKS).exists():
        return Written("track")
    return Written("calibrate" if "solved" in manifest else "batch")
