"""Commands on sessions whose session.toml names their tools."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.batch_sessions import QUICK
from helpers.commands import run_command
from helpers.files import read_image, write_image
from helpers.places import bundled_path
from helpers.session_worlds import make_frames_in_memory, write_folder
from helpers.stereo_sessions import make_session_of_two_tools
from helpers.transforms import moved

from dvrk_cmaes import Body

pytestmark = pytest.mark.usefixtures("tasks_here", "estimates_shared")


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    path = tmp_path / "quick.toml"
    path.write_text(QUICK, encoding="utf-8")
    return path


@pytest.fixture
def folder(tmp_path: Path, bundled_body: Body) -> Path:
    return make_session_of_two_tools(tmp_path / "session", bundled_body)


def test_command_for_one_tool_asks_which(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refusal = run_command(capsys, "golden", "record", folder).refusal
    assert refusal.endswith("session.toml: tool: expected one, got PSM1, PSM2")


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


def test_path_of_the_instrument_that_the_session_names_is_no_other_one(
    folder: Path, quick: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder.parent)
    urdf = bundled_path("instruments", "lnd", "lnd.urdf")
    text = (folder / "session.toml").read_text(encoding="utf-8")
    (folder / "session.toml").write_text(text.replace('"lnd"', json.dumps(str(urdf))), encoding="utf-8")
    relative = os.path.relpath(urdf, folder.parent)
    arguments = ("batch", folder, "--out", "out", "--config", quick, "--workers", 1, "--frames", "0000")
    assert "session.toml names" not in run_command(capsys, *arguments, "--instrument", relative, "--only", "PSM1").err


@pytest.fixture(scope="module")
def two_arms(bundled_body: Body, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a session of two arms that have one base, each seen in four frames, and the results of their frames."""
    place = tmp_path_factory.mktemp("two_arms")
    frames = make_frames_in_memory(bundled_body, 8, level="clean")[2]
    lines = ['[camera]\nfile = "camera.yaml"']
    for arm, own in (("PSM1", frames[:4]), ("PSM2", frames[4:])):
        write_folder(place / arm / "session", own)
        written = place / arm / "session"
        (place / "session").mkdir(exist_ok=True)
        (place / "results").mkdir(exist_ok=True)
        (written / "masks").rename(place / "session" / f"masks_{arm}")
        (written / "joints.csv").rename(place / "session" / f"joints_{arm}.csv")
        (written / "camera.yaml").rename(place / "session" / "camera.yaml")
        (place / arm / "results").rename(place / "results" / arm)
        lines.append(f'[[tool]]\narm = "{arm}"\nmasks = "masks_{arm}"\njoints = "joints_{arm}.csv"')
    (place / "session" / "session.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (place / "settings.toml").write_text(QUICK, encoding="utf-8")
    return place


@pytest.mark.parametrize(("away", "agrees"), [(0.02, True), (0.3, False)])
def test_bases_are_tested_against_the_set_up_joints(
    two_arms: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, away: float, agrees: bool
) -> None:
    """Both arms have one base in truth; the set-up joints say that the second one's is some way off."""
    session = shutil.copytree(two_arms / "session", tmp_path / "session")
    poses = {"PSM1": moved(np.eye(4), [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])}
    poses["PSM2"] = moved(poses["PSM1"], [away, 0.0, 0.0, 0.0, 0.0, 0.0])
    held = {"arms": [{"name": name, "measured_cp": pose.tolist()} for name, pose in poses.items()]}
    (session / "suj-fixed.json").write_text("// fixed\n" + json.dumps(held))
    arguments = ("--results", two_arms / "results", "--config", two_arms / "settings.toml", "--workers", 1)
    ran = run_command(capsys, "calibrate", session, "--out", tmp_path / "out", *arguments)
    found = json.loads((tmp_path / "out" / "arms.json").read_text(encoding="utf-8"))["arms"]["PSM2"]["setup_joints"]
    assert found["agrees"] is agrees
    assert found["off_mm"] == pytest.approx(1e3 * away, abs=5)
    assert ("from where suj-fixed.json has it: exchanged arms" in ran.err) is not agrees
    assert ran.code in ((0, 3) if agrees else (3,))
    (session / "suj-fixed.json").write_text('{"arms": [{"name": "PSM1"}]}')
    refused = run_command(capsys, "calibrate", session, "--out", tmp_path / "again", *arguments).refusal
    assert "suj-fixed.json: arms[0]" in refused


@pytest.mark.parametrize(
    ("given", "frames"), [("images/0003.jpg", ["0003"]), ("masks/000[12].png", ["0001", "0002"]), ("*.jpg", ["0002"])]
)
def test_a_photo_or_a_pattern_names_frames_of_its_folder(
    tmp_path: Path, quick: Path, capsys: pytest.CaptureFixture[str], given: str, frames: list[str]
) -> None:
    folder = tmp_path / "own"
    shutil.copytree(bundled_path("demo"), folder)
    if given == "*.jpg":
        picture = read_image(folder / "images" / "0002.jpg")
        write_image(folder / "0002.jpg", cv2.resize(picture, (320, 240), interpolation=cv2.INTER_AREA))
        shutil.rmtree(folder / "images")
        shutil.rmtree(folder / "masks")
    ran = run_command(capsys, "batch", folder / given, "--out", tmp_path / "out", "--config", quick, "--workers", 1)
    assert ran.code in (0, 3), ran.err
    assert sorted(path.stem for path in (tmp_path / "out" / "frames").iterdir()) == frames


def test_all_missing_inputs_of_a_frame_are_named_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    said = run_command(capsys, "estimate").refusal
    assert said.startswith("--mask: expected a mask, or an image")
    assert "--camera: expected a camera file, got none; without a calibration: `dvrk-cmaes calibrate" in said
