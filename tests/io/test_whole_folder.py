"""A folder that is written whole, and replaced only if all of it is of the same command."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io import output as output_module
from dvrk_cmaes.io.json_file import write_text
from dvrk_cmaes.io.output import output, whole_folder


def write(out: Path, text: str, *, command: str = "synth", kept: tuple[str, ...] = ()) -> None:
    with whole_folder(out, command, overwrite=out.exists(), kept=kept) as made:
        write_text(made / "camera.yaml", text)
        (made / "images").mkdir(exist_ok=True)
        (made / "images" / "0.png").write_text(text)  # as other libraries do


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
    "added": (add_mask, "masks/0.png was not written by `synth`"),
    "edited": (lambda out: (out / "camera.yaml").write_text("mine"), "camera.yaml was not written by `synth`, or chan"),
    "link": (link_image, "images/0.png: expected a place to write"),
    "folder linked": (
        lambda out: os.symlink("/", out / "all"),
        "all: expected a place to write, got",
    ),
    "without a list": (
        lambda out: (out / "run.json").unlink(),
        "one of an earlier synth, got one with came",
    ),
    "damaged list": (
        lambda out: (out / "run.json").write_text("[]"),
        "run.json: expected what an earlier",
    ),
    "list of another folder": (
        lambda out: (out / "run.json").write_text('{"command": "synth", "files": {"../x": ""}}'),
        r"run.json: files: expected paths in the folder and their digests, got '\.\./x'",
    ),
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
    with pytest.raises(InputError, match="it has what `synth` wrote, which stays as it is"):
        write(out, "second", command="import")
    assert content(out) == before


def test_file_that_is_added_while_the_new_folder_is_written_is_kept(out: Path) -> None:
    def overwrite() -> None:
        with whole_folder(out, "synth", overwrite=True) as made:
            (made / "camera.yaml").write_text("second")
            add_mask(out)

    with pytest.raises(InputError, match=r"masks/0\.png was not written"):
        overwrite()
    assert (out / "masks" / "0.png").read_text() == "mine"
    assert (out / "camera.yaml").read_text() == "first"


@pytest.mark.parametrize("in_one_step", [True, False])
@pytest.mark.parametrize("link", [True, False])
def test_own_folder_is_replaced(out: Path, monkeypatch: pytest.MonkeyPatch, in_one_step: bool, link: bool) -> None:
    if not in_one_step:
        monkeypatch.setattr(output_module, "RENAME_EXCHANGE", -1)  # no such flag
    if link:
        os.symlink(out, out.parent / "link")
    write(out.parent / "link" if link else out, "second")
    assert (out / "images" / "0.png").read_text() == "second"
    assert {path.name for path in out.parent.iterdir()} - {"link"} == {"out"}
    write(out, "third")


def test_what_is_kept_is_in_the_new_folder(out: Path) -> None:
    with output(out / "alone", "batch"):
        write_text(out / "alone" / "a.json", "kept")
    write(out, "second", kept=("alone",))
    assert (out / "alone" / "a.json").read_text() == "kept"
    assert (out / "camera.yaml").read_text() == "second"


def test_failure_leaves_the_earlier_folder(out: Path) -> None:
    before = content(out)

    def fail() -> None:
        with whole_folder(out, "synth", overwrite=True) as made:
            write_text(made / "camera.yaml", "half")
            raise ValueError("half written")

    with pytest.raises(InputError, match="half written"):
        fail()
    assert content(out) == before
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_folder_that_a_killed_run_left_is_removed_by_the_next_one(tmp_path: Path) -> None:
    if (child := os.fork()) == 0:
        with whole_folder(tmp_path / "out", "synth"):
            os._exit(0)  # as if killed: nothing is cleaned up
    os.waitpid(child, 0)
    assert len(list((tmp_path / "out").iterdir())) == 2
    with whole_folder(tmp_path / "out", "synth") as made:
        write_text(made / "camera.yaml", "first")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"camera.yaml", "run.json"}


def test_folder_that_a_live_run_fills_is_left_to_it(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with whole_folder(out, "synth") as made:
        with pytest.raises(DvrkCmaesError, match="another command is writing there"), ThreadPoolExecutor(1) as other:
            other.submit(write, out, "second").result()
        write_text(made / "camera.yaml", "first")
    assert (out / "camera.yaml").read_text() == "first"
    assert not list(out.glob(".lock*"))
