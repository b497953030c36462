"""What is in an output folder: each command writes to its own kind of folder, and leaves all others as they are."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.commands import run_command

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.runs.ownership import check_owned

DEMO = bundled_path() / "demo"
COMMANDS = ("batch", "calibrate", "segment", "track")


def written(folder: Path, **texts: str) -> None:
    """Write files; ``__`` in a name is a slash."""
    for name, text in texts.items():
        path = folder / name.replace("__", "/").replace("_json", ".json").replace("_png", ".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def as_session(folder: Path) -> None:
    shutil.copytree(DEMO, folder, dirs_exist_ok=True)


KINDS: dict[str, Callable[[Path], None]] = {
    "session": as_session,
    "images": lambda folder: written(folder, a_png="mine"),
    "masks": lambda folder: written(folder, masks__0000_png="mine"),
    "batch": lambda folder: written(folder, run_json="{}", frames__0000_json="{}"),
    "calibrate": lambda folder: written(folder, run_json='{"solved": "together"}', session_json="{}"),
    "track": lambda folder: written(folder, run_json="{}", tracks_jsonl="{}"),
    "notes": lambda folder: written(folder, notes_json="mine"),
}


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """The bundled session, in a folder that may be written to."""
    as_session(tmp_path / "session")
    return tmp_path / "session"


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("kind", KINDS)
def test_folder_of_another_kind_is_refused_and_left_as_it_is(
    capsys: pytest.CaptureFixture[str], session: Path, tmp_path: Path, command: str, kind: str
) -> None:
    if command == kind:
        kind = "notes"
    out = tmp_path / "out"
    KINDS[kind](out)
    before = content(out)
    ran = run_command(capsys, command, session, "--out", out)
    assert ran.code == 2
    assert ran.refusal.startswith(f"{out}: ")
    assert content(out) == before


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("link", [False, True])
def test_session_is_no_output_folder_of_its_own(
    capsys: pytest.CaptureFixture[str],
    session: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
    link: bool,
) -> None:
    before = content(session)
    out: Path = Path()
    if link:
        out = tmp_path / "link"
        os.symlink(session, out)
    monkeypatch.chdir(session)
    ran = run_command(capsys, command, session, "--out", out)
    assert ran.code == 2
    assert "got one with " in ran.refusal
    assert content(session) == before


def test_other_files_beside_results_stay_unless_the_folder_is_replaced(tmp_path: Path) -> None:
    KINDS["batch"](tmp_path / "batch")
    KINDS["notes"](tmp_path / "batch")
    check_owned(tmp_path / "batch", "batch", replaces=True)
    KINDS["calibrate"](tmp_path / "calibrated")
    check_owned(tmp_path / "calibrated", "calibrate", replaces=True)
    KINDS["notes"](tmp_path / "calibrated")
    with pytest.raises(InputError, match=r"notes\.json was not written by `calibrate`"):
        check_owned(tmp_path / "calibrated", "calibrate", replaces=True)
