"""Hard use: huge numbers, odd names, limits of the system, empty arguments; each is said in one line that is true."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import run_command

from dvrk_cmaes import Camera, InputError, Tracker, estimate
from dvrk_cmaes.cli import app
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.files import bundled_path
from dvrk_cmaes.io.short_text import escaped
from dvrk_cmaes.joints.reading import read_joint_file

DEMO = bundled_path("demo")
CAMERA = Camera(64, 48, 100.0, 100.0, 32.0, 24.0)
MASK = np.eye(48, 64) > 0
HUGE: Any = 10**400


@pytest.mark.parametrize(
    "call",
    [
        lambda: estimate(MASK, CAMERA, {"jaw": HUGE}),
        lambda: Tracker(CAMERA, "lnd").add_readings(HUGE, {}),
        lambda: Tracker(CAMERA, "lnd", lag=HUGE),
        lambda: Camera(HUGE, 48, 100.0, 100.0, 32.0, 24.0),
        lambda: estimate(np.where(MASK, np.nan, 0.0), CAMERA, {}),
        lambda: estimate(np.where(MASK, np.inf, 1.0), CAMERA, {}),
    ],
)
def test_numbers_that_are_no_floats_are_wrong_input(call: Any) -> None:
    with pytest.raises(InputError, match="expected"):
        call()


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("batch", DEMO, "--out", ""), "--out"),
        (("batch", DEMO, "--out="), "--out"),
        (("synth", ""), "synth"),
    ],
)
def test_empty_argument_is_refused(capsys: pytest.CaptureFixture[str], words: tuple[Any, ...], name: str) -> None:
    assert run_command(capsys, *words).refusal.startswith(f"{name}: expected a value, got an empty one")


@pytest.mark.parametrize("columns", ["0", "-1", "", "wide"])
def test_terminal_of_no_width_is_one_of_the_usual_width(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, columns: str
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    for words in (("--help",), ("estimate", "--help"), ("help",)):
        assert run_command(capsys, *words).code == 0


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.EMFILE, os.strerror(errno.EMFILE), "masks/0001.png"), "open files (ulimit -n)"),
        (BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)), "processes or threads (ulimit -u)"),
        (RuntimeError("can't start new thread"), "processes or threads (ulimit -u)"),
        (OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)), "memory: fewer --workers"),
    ],
)
def test_limit_of_the_system_is_said_as_such(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, error: Exception, said: str
) -> None:
    def limited(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(app, "app", limited)
    ran = run_command(capsys, "demo")
    assert ran.code == 1
    assert f"a limit of the system is reached: {said}" in ran.err


@pytest.mark.parametrize("name", [b"a\nb.png", b"bad\xff.png", b"\x1b[31mred.png"])
def test_mask_with_an_odd_name_fails_by_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: bytes) -> None:
    (tmp_path / "masks").mkdir()
    shutil.copy(DEMO / "camera.yaml", tmp_path)
    shutil.copy(DEMO / "masks" / "0001.png", tmp_path / "masks")
    shutil.copy(DEMO / "masks" / "0001.png", os.fsencode(tmp_path / "masks") + b"/" + name)
    frames = {frame.name: frame.problem for frame in read_session(tmp_path, joints=None).frames}
    assert frames.pop("0001") is None
    ((odd, problem),) = frames.items()
    assert odd.isprintable()
    assert "expected a name in UTF-8 without control characters" in str(problem)
    assert "\x1b" not in run_command(capsys, "inspect", tmp_path).out


def test_control_characters_are_escaped() -> None:
    assert escaped("a\x1b[2Jb\r\u202ec\udcff") == r"a\x1b[2Jb\r\u202ec\udcff"
    assert escaped("Größe 内視鏡 +-") == "Größe 内視鏡 +-"


@pytest.mark.parametrize("name", ["=cmd|' /C calc'!A0", "+1+cmd", "@sum(a1)"])
def test_name_of_a_frame_is_no_formula_in_a_table(name: str) -> None:
    assert csv_text(["frame"], [[name]]).splitlines()[1].lstrip('"').startswith("'")


def test_readings_with_nul_are_refused_at_the_first_one(tmp_path: Path) -> None:
    path = tmp_path / "joints.csv"
    path.write_bytes(b"frame,yaw\n0,0.1\n" + b"\0" * 1_000_000)
    with pytest.raises(InputError, match="got a NUL byte at 16"):
        read_joint_file(path)


@pytest.mark.parametrize("px", [16, 40])
def test_mask_of_a_chequerboard_is_doubtful(px: int) -> None:
    session = read_session(DEMO)
    row, column = np.indices((session.rig.camera.height, session.rig.camera.width)) // px
    board = (row + column) % 2 > 0
    board[row == 0] = board[column == 0] = False
    found = estimate(board, session.rig.camera, session.frames[0].readings)
    assert found.status != "ok"
    assert found.tip_probability is None or found.tip_probability < 0.5
