"""``dvrk-cmaes calibrate``: from a folder to session.json, and its use by other commands."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.batch_sessions import QUICK
from helpers.commands import Ran, run_command
from helpers.places import ROOT
from helpers.printed_blocks import blocks, printed_parts, words
from helpers.session_worlds import SMALL, make_frames_in_memory, write_folder

from dvrk_cmaes import Body, read_calibration, read_camera, read_results

pytestmark = pytest.mark.usefixtures("tasks_here")

Command = Callable[..., Ran]

SETTINGS = QUICK


@pytest.fixture(scope="module")
def place(bundled_body: Body, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a folder with a session, the results of its frames, and settings for tests."""
    place = tmp_path_factory.mktemp("calibrate")
    write_folder(place / "session", make_frames_in_memory(bundled_body, 5, level="clean")[2])
    (place / "settings.toml").write_text(SETTINGS, encoding="utf-8")
    return place


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, place: Path) -> Command:
    """Run a command in the folder."""
    monkeypatch.chdir(place)
    return lambda *arguments: run_command(capsys, *arguments)


QUICKLY = ("--config", "settings.toml", "--workers", "1")


@pytest.fixture(scope="module")
def calibrated(place: Path) -> Path:
    """Calibrate once for the tests that only read the output; gives the output folder."""
    from helpers.commands import main

    before = {path: path.read_bytes() for path in (place / "results").rglob("*") if path.is_file()}
    options = ["--results", place / "results", "--out", place / "calibrated", "--config", place / "settings.toml"]
    assert main([str(one) for one in ("calibrate", place / "session", "--workers", "1", *options)]) == 0
    assert {path: path.read_bytes() for path in (place / "results").rglob("*") if path.is_file()} == before
    return place / "calibrated"


@pytest.mark.usefixtures("own_processes")
def test_results_do_not_depend_on_number_of_processes(calibrated: Path, command: Command, place: Path) -> None:
    ran = command("calibrate", "session", "--results", "results", "--out", "two", *QUICKLY[:-1], "2")
    assert ran.code == 0
    for path in (Path("session.json"), *(Path("frames", f"000{k}.json") for k in range(5))):
        one, two = (json.loads((folder / path).read_text()) for folder in (calibrated, place / "two"))
        assert one | {"seconds": 0} == two | {"seconds": 0}
    for folder in ("overlays", "overlays_left_out"):
        for path in (calibrated / folder).iterdir():
            assert path.read_bytes() == (place / "two" / folder / path.name).read_bytes()


@pytest.mark.usefixtures("own_processes")
def test_frames_are_estimated_first_without_results(
    command: Command, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[object] = []
    make = ProcessPoolExecutor.__init__

    def begun(executor: ProcessPoolExecutor, *arguments: Any) -> None:
        started.append(executor)
        make(executor, *arguments)

    monkeypatch.setattr(ProcessPoolExecutor, "__init__", begun)
    ran = command("calibrate", "session", "--out", "whole", *QUICKLY)
    assert ran.code in (0, 3)
    assert len(started) == 1  # the processes that estimated the frames have fitted and drawn them, too
    alone = [json.loads(path.read_text()) for path in (place / "whole" / "alone" / "frames").iterdir()]
    assert [one["source"] for one in alone] == ["frame"] * 5
    lines = ran.out.splitlines()
    assert lines[0].split() == ["arm's", "base", "in", "the", "camera", "x", "y", "z"]
    assert [line.split()[0] for line in lines[6:11]] == ["insertion,", "roll,", "wrist_pitch,", "wrist_yaw,", "jaw,"]
    assert any(" frames; each predicted by the others, without its image: mean IoU 0." in line for line in lines)
    assert lines[-1] == "written: whole/session.json   frames: whole/frames   page: whole/report.html"


# refused input: one line, and nothing written


def refusal(command: Command, *arguments: Any) -> str:
    ran = command("calibrate", *arguments)
    assert ran.code == 2
    return ran.err.splitlines()[-1].removeprefix("dvrk-cmaes: ")


def test_wrong_arm_is_refused(command: Command, place: Path) -> None:
    options = ("--results", "results", "--out", "wrong", "--arm", "si", *QUICKLY)
    assert "51 mm longer: expected --arm" in refusal(command, "session", *options)
    assert not (place / "wrong").exists()


def test_refined_camera_is_written_and_stated(command: Command, bundled_body: Body, tmp_path: Path) -> None:
    write_folder(tmp_path / "session", make_frames_in_memory(bundled_body, 10, level="clean")[2])
    folders = (tmp_path / "session", "--results", tmp_path / "results", "--out", tmp_path / "out")
    ran = command("calibrate", *folders, "--refine-camera", *QUICKLY)
    assert ran.code in (0, 3)
    assert any(line.startswith("camera, against the one used: focal length ") for line in ran.out.splitlines())
    found = read_calibration(tmp_path / "out" / "session.json")
    assert found.blocks["camera"].applied
    written = read_camera(tmp_path / "out" / "camera.yaml")
    right = found.corrected(SMALL)
    assert (written.fx, written.cx, written.cy) == pytest.approx((right.fx, right.cx, right.cy), abs=1e-4)
    assert written.fx == pytest.approx(SMALL.fx, rel=0.03)


def test_camera_without_a_file_is_found(command: Command, bundled_body: Body, tmp_path: Path) -> None:
    """The guess has a focal length 6 % too short; frames are estimated again with what the first solution tells."""
    write_folder(tmp_path / "session", make_frames_in_memory(bundled_body, 10, level="clean")[2])
    (tmp_path / "session" / "camera.yaml").unlink()
    ran = command("calibrate", tmp_path / "session", "--out", tmp_path / "out", *QUICKLY)
    assert "finding the camera with 10 frames" in ran.err
    assert ran.code in (0, 3)
    assert "no camera file: these frames determine a focal length of " in ran.err
    page = (ROOT / "data" / "reference" / "uncalibrated.md").read_text(encoding="utf-8")
    (shown,) = (block.text for block in blocks(page) if block.text.startswith("no camera file"))
    (warning,), (camera,) = ([" ".join(part)] for part in printed_parts(shown))
    said = [" ".join(words(text)) for text in (ran.err, ran.out)]
    assert warning in said[0]
    assert camera in said[1]
    written = read_camera(tmp_path / "out" / "camera.yaml")
    calibration = read_calibration(tmp_path / "out" / "session.json")
    assert abs(np.log(written.fx / SMALL.fx)) < 3 * calibration.blocks["camera"].std[0]
    assert calibration.corrected(written) == written  # it is the session's own from here on
    again = ("--session", tmp_path / "out", "--camera", tmp_path / "out" / "camera.yaml", "--frames", "0000")
    assert command("batch", tmp_path / "session", *again, "--out", tmp_path / "again", *QUICKLY).code in (0, 3)
    one = read_results(tmp_path / "again").frames["0000"]
    assert one.source == "session"


def test_camera_is_not_guessed_beside_a_file_or_from_few_frames(command: Command, place: Path, tmp_path: Path) -> None:
    options = ("--results", place / "results", "--out", tmp_path / "out", *QUICKLY)
    both = ("--focal", "500", "--camera", place / "session" / "camera.yaml")
    assert refusal(command, "session", *both, *options) == "--focal: expected either this or --camera, got both"
    text = refusal(command, "session", "--focal", "5", *options)
    assert text == "--focal: expected a focal length of 96 to 1920 px, 0.3 to 6 widths of the images, got 5"
    text = refusal(command, "session", "--focal", "500", *options)
    assert text.startswith("--camera: expected a camera file, which these frames do not replace: camera: 5 frames; ")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--every", "4"], "--every: no option here; use --keyframes, or --frames with a pattern"),
        (["--seed", "3"], "--seed: no option here; use seed in the settings file (--config)"),
        (["--crop=1,2,3,4"], "--crop: no option here; use right, crop or stretch of [camera] in session.toml"),
        (["--keyframes", "2"], "--keyframes: expected a whole number of at least 3, got 2"),
    ],
)
def test_wrong_shares_of_a_recording_are_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, options: list[str], expected: str
) -> None:
    ran = run_command(capsys, "calibrate", str(tmp_path), *options)
    assert ran.code == 2
    assert expected in ran.err
