"""Commands on sessions whose session.toml names their tools."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.batch_sessions import QUICK
from helpers.commands import run_command
from helpers.stereo_sessions import POSES, SECOND_POSES, make_session_of_two_tools

from dvrk_cmaes.geometry import transform
from dvrk_cmaes.silhouette import Body

SHIFTS = {"PSM1": transform(np.eye(3), [-0.012, 0, 0]), "PSM2": transform(np.eye(3), [0.012, 0, 0])}


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    path = tmp_path / "quick.toml"
    path.write_text(QUICK, encoding="utf-8")
    return path


@pytest.fixture
def folder(tmp_path: Path, bundled_body: Body) -> Path:
    return make_session_of_two_tools(tmp_path / "session", bundled_body)


def test_batch_estimates_every_arm(folder: Path, quick: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder.parent / "out"
    ran = run_command(capsys, "batch", folder, "--out", out, "--config", quick, "--workers", 1, "--json")
    summaries = json.loads(ran.out)
    assert set(summaries) == {"PSM1", "PSM2"}, ran.err
    for arm, poses in (("PSM1", POSES), ("PSM2", SECOND_POSES)):
        assert summaries[arm]["counts"]["frames"] == 2
        for name, truth in poses.items():
            result = json.loads((out / arm / "frames" / f"{name}.json").read_text(encoding="utf-8"))
            found, true = np.array(result["camera_from_root"]), SHIFTS[arm] @ truth
            assert np.linalg.norm(found[:3, 3] - true[:3, 3]) < 8e-3
        assert (out / arm / "report.html").is_file()


def test_one_arm_can_be_chosen(folder: Path, quick: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder.parent / "out"
    arguments = ("batch", folder, "--out", out, "--config", quick, "--workers", 1)
    run_command(capsys, *arguments, "--only", "PSM2", "--frames", "0000")
    assert (out / "PSM2" / "frames" / "0000.json").is_file()
    assert not (out / "PSM1").exists()
    assert "arm: expected one of PSM2, PSM1, got 'PSM22'" in run_command(capsys, *arguments, "--only", "PSM22").refusal


def test_command_for_one_tool_asks_which(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refusal = run_command(capsys, "calibrate", folder, "--out", folder.parent / "out").refusal
    assert refusal.endswith("session.toml: tool: expected one, or the choice of an arm (--only ARM), got PSM1, PSM2")


def test_arm_needs_a_session_that_names_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "session.toml").unlink()
    refusal = run_command(capsys, "batch", folder, "--only", "PSM1").refusal
    assert refusal.startswith("--only: expected a session.toml that names arms")


def test_other_instrument_than_the_session_names_is_warned_about(
    folder: Path, quick: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (folder / "session.toml").read_text(encoding="utf-8")
    (folder / "session.toml").write_text(text.replace('"lnd"', '"nowhere.urdf"'), encoding="utf-8")
    arguments = ("batch", folder, "--out", folder.parent / "out", "--config", quick, "--workers", 1)
    assert "nowhere.urdf" in run_command(capsys, *arguments).refusal
    ran = run_command(capsys, *arguments, "--instrument", "lnd", "--only", "PSM1", "--frames", "0000")
    assert "PSM1: session.toml names" in ran.err
    assert "but --instrument lnd is used" in ran.err
