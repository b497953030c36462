"""The folder that a command writes to: its run.json, its lock, links in it, and files of the user."""

from __future__ import annotations

import errno
import fcntl
import json
import multiprocessing
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io import output as output_module
from dvrk_cmaes.io.json_file import write_text
from dvrk_cmaes.io.output import LONG, Output, check_files, output, remove, whole_file

FILES = ("frames/a.json", "summary.json")


def write(
    out: Path,
    text: str = "x",
    *,
    replaces: bool = False,
    names: tuple[str, ...] = FILES,
) -> None:
    with output(out, "batch") as own:
        if replaces:
            own.remove_stale()
        for name in names:
            write_text(out / name, text)


def listed(out: Path) -> set[str]:
    return set(json.loads((out / "run.json").read_text())["files"])


def test_files_are_listed_and_replaced(tmp_path: Path) -> None:
    out = tmp_path / "a" / "out"
    write(out)
    assert listed(out) == set(FILES)
    write(out, "y", replaces=True, names=("frames/b.json",))
    assert listed(out) == {"frames/b.json"}
    assert sorted(path.name for path in out.iterdir()) == ["frames", "run.json"]
    assert not (out / "frames" / "a.json").exists()


@pytest.mark.parametrize("place", ["frames", "frames/a.json", "summary.json", "run.json", "new"])
@pytest.mark.parametrize("target", ["folder", "file", "nothing", "loop"])
@pytest.mark.parametrize("earlier", [True, False])
def test_nothing_is_written_or_removed_through_a_link(tmp_path: Path, place: str, target: str, earlier: bool) -> None:
    session, home = tmp_path / "session", tmp_path / "home"
    out, home_files = session / "results", {home / name: f"{name} of the user" for name in ("a.json", "file")}
    home.mkdir()
    for path, text in home_files.items():
        path.write_text(text)
    session.mkdir()
    if earlier:
        write(out)
        if (out / place).is_dir():
            (out / place).rename(tmp_path / "apart")
        else:
            (out / place).unlink(missing_ok=True)
    link = out / place
    link.parent.mkdir(parents=True, exist_ok=True)
    os.symlink({"folder": home, "file": home / "file", "nothing": home / "new", "loop": link}[target], link)
    for replaces in (False, True):
        with pytest.raises(InputError, match="got a link" if earlier else "got a link|new or empty folder"):
            write(out, replaces=replaces)
    assert {path: path.read_text() for path in home.iterdir()} == home_files
    assert os.path.islink(link)


USERS: dict[str, Callable[[Path], None]] = {
    "write": lambda out: write_text(out / "summary.json", "y"),
    "remove": lambda out: remove(out / "summary.json"),
    "whole file": lambda out: _write_whole(out / "summary.json"),
}


def _write_whole(path: Path) -> None:
    with whole_file(path, "a file") as made:
        made.write_text("y")


@pytest.mark.parametrize("does", USERS)
def test_changed_file_is_neither_replaced_nor_removed(tmp_path: Path, does: str) -> None:
    out = tmp_path / "out"
    write(out)
    with output(out, "batch"):
        USERS[does](out)
    write_text(out / "summary.json", "mine")
    with pytest.raises(InputError, match=r"summary\.json was not written by `batch`, or changed"), output(out, "batch"):
        USERS[does](out)
    assert (out / "summary.json").read_text() == "mine"


def test_list_is_whole_after_a_process_was_killed(tmp_path: Path) -> None:
    write(tmp_path / "out")
    if (child := os.fork()) == 0:
        with output(tmp_path / "out", "batch") as own:
            write_text(tmp_path / "out" / "summary.json", "y")
            write_text(tmp_path / "out" / "b.json", "y")
            own.note("frames/a.json", "f" * 64)  # and killed before it was written
            os._exit(0)
    os.waitpid(child, 0)
    write(tmp_path / "out", "z", replaces=True)
    assert listed(tmp_path / "out") == set(FILES)
    assert not (tmp_path / "out" / "b.json").exists()


def test_folder_of_another_command_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "out")
    with pytest.raises(InputError, match="it has what `batch` wrote"):
        check_files(tmp_path / "out", "track", [])


def test_refused_run_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError), output(tmp_path / "a" / "b", "batch"):
        raise InputError("refused")
    assert not (tmp_path / "a").exists()


def _one(arguments: tuple[Path, int]) -> None:
    out, number = arguments
    with output(out, "estimate", wait=LONG):
        write_text(out / "frames" / f"{number}.json", f"{number}")


def test_commands_that_write_at_once_are_all_listed(tmp_path: Path) -> None:
    with multiprocessing.get_context("fork").Pool(4) as pool:
        pool.map(_one, [(tmp_path / "out", number) for number in range(200)], chunksize=1)
    names = {f"frames/{number}.json" for number in range(200)}
    assert listed(tmp_path / "out") == names
    assert {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.json")} == {
        *names,
        "run.json",
    }
    assert not list((tmp_path / "out").glob(".lock*"))


def _checked(path: Path) -> int:
    """Check folders until a file ``done`` is there; return how often."""
    checks = 0
    while not (path / "done").exists():
        for number in range(5):
            check_files(path / f"{number}", "estimate", ["frames/a.json"])
        checks += 1
    return checks


def test_check_of_a_folder_that_another_command_writes_to_never_fails(tmp_path: Path) -> None:
    with multiprocessing.get_context("fork").Pool(1) as others:
        checked = others.map_async(_checked, [tmp_path])
        for number in range(40):
            out = tmp_path / f"{number // 8}"
            with output(out, "estimate", wait=LONG):
                write_text(out / "frames/a.json", f"{number}")
        (tmp_path / "done").touch()
        assert all(checked.get())


def test_folder_that_is_replaced_by_a_link_meanwhile_is_not_written_to(tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "results", tmp_path / "elsewhere"
    elsewhere.mkdir()
    with output(folder, "batch"):
        folder.rename(tmp_path / "moved")
        folder.symlink_to(elsewhere)
        with pytest.raises(InputError, match="expected the folder in which the command began, got another one"):
            write_text(folder / "b.txt", "b")
        assert not any(elsewhere.iterdir())
        folder.unlink()
        (tmp_path / "moved").rename(folder)
        write_text(folder / "b.txt", "b")
    assert listed(folder) == {"b.txt"}


def test_folder_whose_files_were_not_written_yet_is_that_of_the_command(tmp_path: Path) -> None:
    with output(tmp_path / "out", "estimate") as own:
        write_text(tmp_path / "out" / "a.json", "x")
        shutil.copytree(own.path, tmp_path / "killed")  # as a process leaves it that is killed here
    check_files(tmp_path / "killed", "estimate", ["a.json"])


def test_full_disk_leaves_no_empty_list(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))

    monkeypatch.setattr(output_module.os, "replace", full)
    with pytest.raises(DvrkCmaesError, match="not written"), output(tmp_path / "out", "batch"):
        pass
    assert not (tmp_path / "out").exists()


def test_note_that_a_full_disk_or_a_power_cut_cuts_off_is_left_out(tmp_path: Path) -> None:
    write(tmp_path / "out")
    run = tmp_path / "out" / "run.json"
    run.write_bytes(run.read_bytes().removesuffix(b"\n }\n}\n") + b',\n  "frames/b.js')
    write(tmp_path / "out", "y", replaces=True)
    assert listed(tmp_path / "out") == set(FILES)


@pytest.fixture
def no_flock(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOTSUP, os.strerror(errno.ENOTSUP))

    monkeypatch.setattr(fcntl, "flock", fail)


@pytest.mark.usefixtures("no_flock")
def test_file_stands_for_the_lock_where_the_file_system_has_none(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with output(out, "batch"):
        assert (out / ".lock").exists()
        with (
            pytest.raises(DvrkCmaesError, match=r"another command is writing there; wait .*, or remove .*\.lock if"),
            ThreadPoolExecutor(1) as other,
        ):
            other.submit(write, out).result()
        write_text(out / "a", "a")
    assert not (out / ".lock").exists()
    write(out)
    (out / ".lock").write_text("")  # as of a process that was killed
    with pytest.raises(DvrkCmaesError, match="another command is writing"):
        write(out)


def test_functions_that_write_are_those_of_one_module() -> None:
    package = Path(output_module.__file__).parents[1]
    own = {"io/output.py"}
    writes = (
        ".unlink(",
        ".write_text(",
        ".write_bytes(",
        "rmtree(",
        "os.replace(",
        ".mkdir(",
        "os.remove(",
        "os.rename(",
    )
    found = {
        f"{path.relative_to(package).as_posix()}: {word}"
        for path in package.rglob("*.py")
        if path.relative_to(package).as_posix() not in own
        for word in writes
        if word in path.read_text(encoding="utf-8")
    }
    assert found == set()
    assert Output.__module__ == "dvrk_cmaes.io.output"
