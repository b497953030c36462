"""A folder that is written whole, and replaced only if all of it is of the same command."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io import atomic_folder
from dvrk_cmaes.io.output import whole_folder


def write(out: Path, text: str, *, command: str = "synth") -> None:
    with whole_folder(out, command=command, sign="camera.yaml", overwrite=out.exists()) as beside:
        (beside / "camera.yaml").write_text(text)
        (beside / "images").mkdir()
        (beside / "images" / "0.png").write_text(text)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    write(tmp_path / "out", "first")
    return tmp_path / "out"


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def add_mask(out: Path) -> None:
    (out / "masks").mkdir()
    (out / "masks" / "0.png").write_text("mine")


def link_image(out: Path) -> None:
    (out / "images" / "0.png").rename(out.parent / "mine.png")
    os.symlink(out.parent / "mine.png", out / "images" / "0.png")


CHANGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "added": (add_mask, "masks/0.png was added or changed since"),
    "edited": (lambda out: (out / "camera.yaml").write_text("mine"), "camera.yaml was added or changed since"),
    "link": (link_image, "images/0.png was added or changed since"),
    "folder linked": (lambda out: os.symlink("/", out / "all"), "all was added or changed since"),
    "without a record": (lambda out: (out / ".written.json").unlink(), "expected a folder that `synth` wrote"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_folder_with_files_of_the_user_stays_as_it_is(out: Path, change: str) -> None:
    do, expected = CHANGES[change]
    do(out)
    before = content(out)
    with pytest.raises(InputError, match=expected):
        write(out, "second")
    assert content(out) == before


def test_folder_of_another_command_stays_as_it_is(out: Path) -> None:
    before = content(out)
    with pytest.raises(InputError, match="expected a folder that `import` wrote"):
        write(out, "second", command="import")
    assert content(out) == before


def test_file_that_is_added_while_the_new_folder_is_written_is_kept(out: Path) -> None:
    def overwrite() -> None:
        with whole_folder(out, "synth", overwrite=True) as beside:
            (beside / "camera.yaml").write_text("second")
            add_mask(out)

    with pytest.raises(InputError, match=r"masks/0\.png was added"):
        overwrite()
    assert (out / "masks" / "0.png").read_text() == "mine"
    assert (out / "camera.yaml").read_text() == "first"


@pytest.mark.parametrize("in_one_step", [True, False])
def test_own_folder_is_replaced(out: Path, monkeypatch: pytest.MonkeyPatch, in_one_step: bool) -> None:
    if not in_one_step:
        monkeypatch.setattr(atomic_folder, "_RENAME_EXCHANGE", -1)  # no such flag
    write(out, "second")
    assert (out / "images" / "0.png").read_text() == "second"
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_folder_that_a_killed_run_left_is_removed_by_the_next_one(tmp_path: Path) -> None:
    if (child := os.fork()) == 0:
        with whole_folder(tmp_path / "out", command="synth", sign="camera.yaml"):
            os._exit(0)  # as if killed: nothing is cleaned up
    os.waitpid(child, 0)
    (tmp_path / f".{'a' * 32}.tmp").mkdir()  # of another target
    assert len(list(tmp_path.iterdir())) == 2
    write(tmp_path / "out", "first")
    assert {path.name for path in tmp_path.iterdir()} == {"out", f".{'a' * 32}.tmp"}


def test_folder_that_a_live_run_fills_is_not_removed_by_another_one(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with whole_folder(out, "synth") as beside:
        with pytest.raises(InputError, match="half"), whole_folder(out, "synth"):
            raise InputError("half")
        assert beside.is_dir()
        (beside / "camera.yaml").write_text("first")
    assert (out / "camera.yaml").read_text() == "first"
