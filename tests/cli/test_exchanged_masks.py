"""``batch`` and ``track`` on sessions of two arms of which each is given the masks of the other."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from helpers.batch_sessions import QUICK
from helpers.commands import run_command
from helpers.moving_worlds import SMALL

from dvrk_cmaes.frames.session_toml import ToolEntry
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.session import SessionPlan
from dvrk_cmaes.synth.two_arms import write_two_arms
from dvrk_cmaes.synth.two_arms_recording import write_recording_of_arms

pytestmark = pytest.mark.usefixtures("tasks_here", "estimates_shared")

TOOL = ToolEntry("PSM1", "classic", "lnd")
EXCHANGED = "PSM1 and PSM2: the readings of each fit the masks of the other better"


@pytest.fixture(scope="module")
def frames(bundled_body: Body, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of single frames of two arms."""
    folder = tmp_path_factory.mktemp("frames") / "session"
    write_two_arms(folder, SessionPlan(bundled_body, SMALL, LEVELS["clean"], "rcm", 3, 7, {}), TOOL)
    return folder


@pytest.fixture(scope="module")
def recording(bundled_body: Body, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of two arms."""
    folder = tmp_path_factory.mktemp("recording") / "session"
    plan = SessionPlan(bundled_body, SMALL, LEVELS["clean"], "video", 6, 3, {})
    write_recording_of_arms(folder, plan, TOOL)
    return folder


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    path = tmp_path / "quick.toml"
    path.write_text(QUICK, encoding="utf-8")
    return path


def with_exchanged_masks(folder: Path, to: Path) -> Path:
    """Copy a session, with the label of each tool given to the other."""
    shutil.copytree(folder, to)
    text = (to / "session.toml").read_text(encoding="utf-8")
    labels = {"label = 1": "label = 2", "label = 2": "label = 1"}
    lines = [labels.get(line, line) for line in text.splitlines()]
    (to / "session.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return to


def test_batch_names_tools_whose_masks_are_exchanged(
    frames: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right = run_command(capsys, "batch", frames, "--out", tmp_path / "right", "--workers", 1)
    assert right.code == 0
    assert "exchanged" not in right.err
    wrong = with_exchanged_masks(frames, tmp_path / "session")
    ran = run_command(capsys, "batch", wrong, "--out", tmp_path / "wrong", "--workers", 1)
    assert EXCHANGED in ran.err
    assert ran.code == 3


def test_track_names_tools_whose_masks_are_exchanged(
    recording: Path, quick: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("--config", quick, "--lag", "0", "--no-video", "--no-page")
    right = run_command(capsys, "track", recording, "--out", tmp_path / "right", *arguments)
    assert "exchanged" not in right.err
    wrong = with_exchanged_masks(recording, tmp_path / "session")
    ran = run_command(capsys, "track", wrong, "--out", tmp_path / "wrong", *arguments)
    assert EXCHANGED in ran.err
    assert ran.code == 3
