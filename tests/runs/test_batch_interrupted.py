"""A batch that is interrupted: running frames are finished, and the same command goes on from there."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.batch_sessions import QUICK, make_session
from helpers.waiting import wait_for

COMMAND = [sys.executable, "-m", "dvrk_cmaes", "batch"]


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    """A batch of eight frames, to which the number of workers is still to be added."""
    session = make_session(tmp_path / "session", [f"{k:02d}" for k in range(8)])
    (tmp_path / "quick.toml").write_text(QUICK)
    options = ["--config", tmp_path / "quick.toml", "--out", tmp_path / "out"]
    return [*COMMAND, str(session), *map(str, options)]


def results(tmp_path: Path) -> list[Path]:
    return list((tmp_path / "out" / "frames").glob("*.json"))


def wait_for_results(batch: subprocess.Popen[str], count: int, tmp_path: Path) -> None:
    """Wait until a running batch has written ``count`` results."""
    wait_for(lambda: len(results(tmp_path)) >= count or batch.poll() is not None, 600)
    if len(results(tmp_path)) < count:
        pytest.fail(f"{len(results(tmp_path))} results only; exit code {batch.wait()}: {batch.communicate()}")


def test_interrupt_finishes_running_frames(command: list[str], tmp_path: Path) -> None:
    pipe = subprocess.PIPE
    two = [*command, "--workers", "2"]
    batch = subprocess.Popen(two, stdout=pipe, stderr=pipe, text=True, start_new_session=True)
    wait_for_results(batch, 2, tmp_path)
    os.killpg(batch.pid, signal.SIGINT)  # to the workers as well, as from a terminal
    out, said = batch.communicate(timeout=600)
    there = len(results(tmp_path))
    assert batch.returncode == 130
    assert 2 <= there < 8
    assert [line for line in said.splitlines() if " a second, " not in line] == [  # without progress, on slow machines
        "dvrk-cmaes: warning: stopping: the frames that are running are finished and written first "
        "(Ctrl-C again: at once)",
        f"dvrk-cmaes: interrupted: {8 - there} of 8 frames are left; the same command goes on from here",
    ]
    assert f"8 frames: {there} ok, {8 - there} missing" in out.splitlines() or "doubtful" in out
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["counts"]["missing"] == 8 - there
    again = subprocess.run([*command, "--workers", "1", "--json"], capture_output=True, text=True, check=False)
    assert again.returncode in (0, 3)
    assert json.loads(again.stdout)["timing"]["run"]["frames"] == 8 - there
    assert again.stderr.splitlines()[0] == (
        f"dvrk-cmaes: results are there of {there} frames, {8 - there} are to be done"
    )
