"""Links in a session folder: those that leave it are refused by each command that reads it."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from helpers.commands import run_command
from helpers.places import bundled_path

from dvrk_cmaes import InputError, read_session
from dvrk_cmaes.frames.session_folder import find_images
from dvrk_cmaes.inspection import Options, inspect_path

DEMO = bundled_path("demo")
PLACES = ("images/0001.jpg", "images", "masks/0001.png", "masks", "joints.csv", "camera.yaml", "golden.json")
COMMANDS = {
    "batch": ("batch", "session", "--out", "out"),
    "calibrate": ("calibrate", "session", "--out", "out"),
    "track": ("track", "session", "--out", "out"),
    "golden": ("golden", "record", "session", "--golden", "out.json"),
    "pnp": ("pnp", "session", "--out", "out"),
    "segment": ("segment", "session", "--out", "out"),
    "inspect": ("inspect", "session"),
    "import": ("import", "session", "--out", "out"),
}


@pytest.fixture(autouse=True)
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The bundled session, in the working folder, beside a folder with the same files."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(DEMO, "session")
    shutil.copytree(DEMO, "elsewhere")
    return Path("session")


def linked(place: str, target: str | None = None) -> Path:
    """Put a link in the place of a file or folder of the session, by default to the same one elsewhere."""
    path = Path("session", place)
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    up = os.path.relpath("elsewhere", path.parent)
    path.symlink_to(f"{up}/{place}" if target is None else target)
    return path


@pytest.mark.parametrize("place", PLACES)
def test_link_that_leaves_the_session_is_refused_by_name(place: str) -> None:
    path = linked(place)
    with pytest.raises(InputError, match=r"a link that leaves it, to .*elsewhere.*; copy what") as refused:
        read_session("session")
    assert str(refused.value).startswith(f"{Path.cwd() / path}: ")


def test_links_within_the_session_and_to_it_are_its_own(session: Path) -> None:
    linked("images/0001.jpg", "0002.jpg")
    shutil.move("session/masks", "session/drawn")
    Path("session/masks").symlink_to("drawn")
    Path("link").symlink_to("session")
    for folder in (session, Path("link")):
        assert len(read_session(folder).frames) == len(read_session("elsewhere").frames)


def test_link_to_nothing_and_loops_are_refused() -> None:
    linked("images/0001.jpg", "../../nothing.jpg")
    with pytest.raises(InputError, match=r"0001\.jpg: .*a link that leaves it, to .*nothing\.jpg"):
        read_session("session")
    linked("images/0001.jpg", "0001.jpg")
    read_session("session")  # the frame fails by itself
    linked("camera.yaml", "camera.yaml")
    with pytest.raises(InputError, match=r"camera\.yaml: "):
        read_session("session")


@pytest.mark.parametrize("place", ["images", "masks", "ignore"])
def test_folder_that_is_a_link_to_nothing_is_not_left_out(place: str) -> None:
    linked(place, "../elsewhere/none")
    with pytest.raises(InputError, match="leaves"):
        read_session("session")


def test_folder_of_masks_of_another_tool_is_checked(session: Path) -> None:
    shutil.copytree("session/masks", "session/masks_other")
    (session / "session.toml").write_text(
        '[[tool]]\narm = "PSM1"\nmasks = "masks"\n[[tool]]\narm = "PSM2"\nmasks = "masks_other"\n'
    )
    linked("masks_other/0001.png", "../../elsewhere/masks/0001.png")
    with pytest.raises(InputError, match=r"masks_other/0001\.png: .*leaves"):
        inspect_path(session, Options())


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_refuses_and_writes_nothing(capsys: pytest.CaptureFixture[str], command: str) -> None:
    linked("images/0001.jpg")
    linked("session.toml")
    words = COMMANDS[command]
    assert "a link that leaves it" in run_command(capsys, *words).refusal
    assert not list(Path("out").rglob("*.png"))
    assert not Path("out.json").exists()


def test_images_of_a_folder_are_checked() -> None:
    linked("images/0001.jpg")
    with pytest.raises(InputError, match=r"0001\.jpg: .*leaves"):
        find_images("session")
