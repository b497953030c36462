"""``dvrk-cmaes batch``: printed output, exit codes and messages."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.batch_sessions import QUICK, make_session
from helpers.commands import main
from helpers.files import read_mask

from dvrk_cmaes import Result
from dvrk_cmaes.cli.batch_progress import progress
from dvrk_cmaes.runs.batch import BatchProgress
from dvrk_cmaes.runs.worker import FrameOutcome

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Run a batch command in an empty folder; gives exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick.toml").write_text(QUICK)

    def go(*arguments: object) -> tuple[int, str, str]:
        code = main(["batch", *map(str, arguments)])
        return code, *capsys.readouterr()

    return go


QUICKLY = ("--config", "quick.toml", "--workers", "1")


@pytest.mark.usefixtures("tasks_here", "estimates_shared")
def test_label_masks_and_other_input_paths(run: Run, tmp_path: Path) -> None:
    session = make_session(tmp_path / "session", ["a"])
    path = session / "masks" / "a.png"
    plain = run("session", "--out", "plain", *QUICKLY, "--json")
    import cv2

    labels = np.where(read_mask(path), 3, 200).astype(np.uint8)
    path.write_bytes(cv2.imencode(".png", labels)[1].tobytes())
    for name in ("camera.yaml", "joints.csv"):
        shutil.move(session / name, tmp_path / name)
    options = ("--label", "3", "--camera", "camera.yaml", "--joints", "joints.csv")
    moved = run("session", "--out", "moved", *QUICKLY, "--json", *options)
    assert plain[0] == moved[0] == 0
    assert json.loads(plain[1])["medians"] == json.loads(moved[1])["medians"]


def test_missing_scheduler_is_refused(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dvrk_cmaes.runs.cluster.CONNECT_S", 0.3)
    make_session(tmp_path / "session", ["a"])
    code, out, said = run("session", "--scheduler", "tcp://127.0.0.1:9")
    assert (code, out) == (2, "")
    assert said.startswith("dvrk-cmaes: --scheduler: expected a Dask scheduler's address, got 'tcp://127.0.0.1:9': ")
    assert said.count("\n") == 1


def outcome(status: str) -> FrameOutcome:
    return FrameOutcome(Result("a", status, (), "lnd", "roll_link", None, {}, {}), None)  # type: ignore[arg-type]


def follow(reporter: BatchProgress) -> None:
    reporter.on_start(4, ["ok"])
    for status in ("ok", "doubtful", "failed"):
        reporter.on_frame(outcome(status))


def test_progress_in_log_is_written_as_lines(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seconds = iter(range(0, 1000, 47))
    monkeypatch.setattr("time.monotonic", lambda: next(seconds))
    with progress() as reporter:
        follow(reporter)
    first, *lines = capsys.readouterr().err.splitlines()
    assert first == "dvrk-cmaes: results are there of 1 frame, 4 are to be done"
    assert lines[-1] == "dvrk-cmaes: 3 of 4 frames, 0.02 a second, 0:00:47 left, 1 doubtful, 1 failed"


def test_progress_on_terminal_is_a_bar(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with progress() as reporter:
        follow(reporter)
    said = capsys.readouterr().err
    assert "3/4" in said
    assert "a second, 1 doubtful, 1 failed" in said
