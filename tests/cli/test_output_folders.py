"""What is in an output folder: each command writes to its own kind of folder, and leaves all others as they are."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers.places import bundled_path

from dvrk_cmaes import InputError, read_session
from dvrk_cmaes.io.output import output, write_bytes
from dvrk_cmaes.runs.manifest import check_same_session, frame_stamps

DEMO = bundled_path() / "demo"


def written(folder: Path, **texts: str) -> None:
    """Write files; ``__`` in a name is a slash."""
    for name, text in texts.items():
        path = folder / name.replace("__", "/").replace("_json", ".json").replace("_png", ".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def by_command(command: str, folder: Path, *names: str) -> None:
    """Write files as a command does."""
    with output(folder, command):
        for name in names:
            write_bytes(folder / name, b"{}")


def as_session(folder: Path) -> None:
    shutil.copytree(DEMO, folder, dirs_exist_ok=True)


KINDS: dict[str, Callable[[Path], None]] = {
    "session": as_session,
    "images": lambda folder: written(folder, a_png="mine"),
    "masks": lambda folder: written(folder, masks__0000_png="mine"),
    "batch": lambda folder: by_command("batch", folder, "frames/0000.json"),
    "calibrate": lambda folder: by_command("calibrate", folder, "session.json"),
    "track": lambda folder: by_command("track", folder, "tracks.jsonl"),
    "notes": lambda folder: written(folder, notes_json="mine"),
}


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """The bundled session, in a folder that may be written to."""
    as_session(tmp_path / "session")
    return tmp_path / "session"


def opened(path: Path, command: str, *, whole: bool = False) -> None:
    """Open a folder, which a command may replace as a whole."""
    with output(path, command, kept=() if whole else None):
        pass


def test_other_files_beside_results_stay_unless_the_folder_is_replaced(tmp_path: Path) -> None:
    KINDS["batch"](tmp_path / "batch")
    KINDS["notes"](tmp_path / "batch")
    opened(tmp_path / "batch", "batch")
    KINDS["calibrate"](tmp_path / "calibrated")
    opened(tmp_path / "calibrated", "calibrate", whole=True)
    KINDS["notes"](tmp_path / "calibrated")
    with pytest.raises(InputError, match=r"notes\.json was not written by `calibrate`"):
        opened(tmp_path / "calibrated", "calibrate", whole=True)


def run_of(session: Path, frames: dict[str, Any]) -> str:
    return json.dumps(
        {"version": "1", "session": str(session), "instrument": {"name": "lnd"}, "config": {}, "frames": frames}
    )


def test_calibration_of_another_session_is_told_from_one_that_was_moved(session: Path, tmp_path: Path) -> None:
    read, out = read_session(session), tmp_path / "out"
    digests = {files.name: frame_stamps(files) for files in read.frames}
    other = {name: dict.fromkeys(parts, "other") for name, parts in digests.items()}
    written(out, run_json=run_of(session, other))
    check_same_session(out, read)
    written(out, run_json=run_of(tmp_path / "before", digests))
    check_same_session(out, read)
    written(out, run_json=run_of(tmp_path / "before", other))
    with pytest.raises(InputError, match=r"it has the results of another session \("):
        check_same_session(out, read)
