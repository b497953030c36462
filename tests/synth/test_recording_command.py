"""``dvrk-cmaes synth --motion video``: images as files or a video, recordings of two arms, and wrong use."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.commands import run_command

CAMERA = "width: 320\nheight: 240\nK: [513, 0, 161, 0, 513, 119, 0, 0, 1]\nD: [0, 0, 0, 0, 0]\n"
Capture = pytest.CaptureFixture[str]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_images_are_files_or_a_video(tmp_path: Path, capsys: Capture) -> None:
    line = ("--motion", "video", "--level", "easy", "--frames", 2)
    for name, more in (("files", ()), ("video", ("--mp4",)), ("masks", ("--no-images",))):
        assert run_command(capsys, "synth", tmp_path / name, *line, *more).code == 0
    assert names(tmp_path / "files" / "images") == ["0000.jpg", "0001.jpg"]
    assert not (tmp_path / "video" / "images").exists()
    assert not (tmp_path / "masks" / "images").exists()
    video = cv2.VideoCapture(str(tmp_path / "video" / "video.mp4"))
    seen = [video.read() for _ in range(3)]
    video.release()
    assert [read for read, _ in seen] == [True, True, False]
    first = cv2.imread(str(tmp_path / "files" / "images" / "0000.jpg"))
    assert np.abs(seen[0][1].astype(int) - first).mean() < 8
    refusal = run_command(capsys, "synth", tmp_path / "not", "--mp4").refusal
    assert "--mp4: expected it with --motion video, --images and one eye only" in refusal


def test_lags_of_two_arms_differ_unless_one_is_given(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "camera.yaml").write_text(CAMERA)
    line = ("synth", tmp_path / "made", "--motion", "video", "--arms", 2, "--frames", 1, "--no-images")
    line = (*line, "--camera", tmp_path / "camera.yaml")
    assert run_command(capsys, *line).code == 0
    lags = json.loads((tmp_path / "made" / "synth.json").read_text())["lags"]
    assert lags["PSM1"] == 1.5
    assert 0.75 <= lags["PSM2"] <= 2.25
    assert lags["PSM1"] != lags["PSM2"]
    assert run_command(capsys, *line, "--lag", "0.1", "--overwrite").code == 0
    lags = json.loads((tmp_path / "made" / "synth.json").read_text())["lags"]
    assert lags == {"PSM1": pytest.approx(3.0), "PSM2": pytest.approx(3.0)}


@pytest.mark.parametrize("wrong", [("--motion", "free"), ("--stereo",)])
def test_other_sessions_of_two_arms_are_refused(tmp_path: Path, capsys: Capture, wrong: tuple[str, ...]) -> None:
    refusal = run_command(capsys, "synth", tmp_path / "made", "--arms", 2, *wrong).refusal
    assert refusal == "--arms: expected --motion video, or --motion rcm and one eye, with two arms"
