"""Invalid file names, unwritable places and full disks: one line, and no partly written files."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.canned_results import canned
from helpers.commands import main
from helpers.demo_files import CAMERA, DEMO, IMAGE, JOINTS, MASK, SMALL_CAMERA, frame
from helpers.made_recordings import good, write_bag, write_video

NAMES = {
    "empty": "",
    "in another script": "ножницы/鉗子.png",
    "of several words": "no such file.png",
    "of two lines": "one\ntwo.png",
    "with a style": "[bold]x[/bold].png",
    "too long": "x" * 300 + ".png",
    "with a null": "a\0b.png",
    "not text": os.fsdecode(b"\xff\xfe.png"),
    "below a file": f"{MASK}/x.png",
    "below a device": "/dev/null/x.png",
    "that looks like an option": "./--mask",
}

READERS: dict[str, Callable[[str], list[object]]] = {
    "mask": lambda name: frame(mask=name),
    "image": lambda name: frame(image=name),
    "ignore": lambda name: frame(ignore=name),
    "camera": lambda name: frame(camera=name),
    "joints": lambda name: frame(joints=name),
    "settings": lambda name: frame(config=name),
    "instrument": lambda name: frame(instrument=name),
    "session": lambda name: ["batch", name],
    "results": lambda name: ["export", name, "--to", "csv"],
    "recording": lambda name: ["import", name, "--out", "made"],
    "recording's camera": lambda name: ["import", "bag", "--camera", name, "--out", "made"],
    "recording's joints": lambda name: ["import", "bag", "--joints", name, "--out", "made"],
}

Said = Callable[[list[object]], str]


@pytest.fixture
def said(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Said:
    """Run a command that must fail in an empty folder, check that it left nothing, and give exit code and line."""
    monkeypatch.chdir(tmp_path)

    def go(arguments: list[object]) -> str:
        before = sorted(tmp_path.rglob("*"))
        code = main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        assert sorted(tmp_path.rglob("*")) == before
        assert printed.out == ""
        assert printed.err.startswith("dvrk-cmaes: ")
        assert printed.err.count("\n") == 1
        return f"{code} {printed.err.removeprefix('dvrk-cmaes: ').strip()}"

    return go


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", NAMES)
def test_invalid_file_name_is_refused(said: Said, tmp_path: Path, reader: str, kind: str) -> None:
    if reader.startswith("recording's"):
        write_bag(tmp_path / "bag", "mcap", good(1))
    message = said(READERS[reader](NAMES[kind]))
    assert message.startswith("2 ")
    assert len(message) < 900


def test_files_with_unusual_names_are_read_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dvrk_cmaes.runs.frame.estimate_views", lambda *_a, **k: canned(k["frame"]))
    folder = tmp_path / "видео 1 [bold] 'q' 鉗子"
    folder.mkdir()
    for path in (MASK, CAMERA, JOINTS, IMAGE):
        shutil.copy(path, folder / f"é {path.name}")
    shutil.copytree(DEMO.parent / "instruments" / "lnd", folder / "ñ lnd")
    arguments = frame(
        mask=folder / "é 0000.png",
        camera=folder / "é camera.yaml",
        joints=folder / "é joints.csv",
        image=folder / "é 0000.jpg",
        instrument=folder / "ñ lnd" / "lnd.urdf",
        out=folder / "aus",
    )
    arguments[arguments.index("--frame") + 1] = "0000"
    assert main([str(argument) for argument in arguments]) == 0, capsys.readouterr().err
    assert (folder / "aus/frames/0000.json").is_file()
    assert (folder / "aus/overlays/0000.jpg").is_file()


# closed stdout and stderr, in a process of its own


def program(shell: str, folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the program by a shell command in which ``$@`` stands for the program and its arguments."""
    words = [
        sys.executable,
        "-c",
        "import sys; from dvrk_cmaes.cli import main; sys.exit(main())",
        *map(str, arguments),
    ]
    return subprocess.run(["sh", "-c", shell, "sh", *words], capture_output=True, text=True, check=False, cwd=folder)


def test_exit_code_without_stdout_or_stderr(tmp_path: Path) -> None:
    write_video(tmp_path / "video.avi", 2)
    (tmp_path / "camera.yaml").write_bytes(SMALL_CAMERA)
    assert program('"$@" >&-', tmp_path, "--version").returncode == 0
    lost = program('"$@" 2>&-', tmp_path, "import", "video.avi", "--out", "x")
    assert (lost.returncode, lost.stdout) == (2, "")
    assert program('"$@" 2>/dev/full', tmp_path, "import", "video.avi", "--out", "x").returncode == 2
