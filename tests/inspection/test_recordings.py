"""Inspection of videos, LeRobot data sets and sessions: sizes, counts, rates, the clock, and what to type next."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest
from helpers.made_recordings import write_video
from helpers.places import ROOT

from dvrk_cmaes.cli.app import app
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.inspection import inspect_path

INFO: dict[str, Any] = {
    "codebase_version": "v2.1",
    "fps": 25,
    "total_episodes": 4,
    "total_frames": 800,
    "features": {
        "observation.state": {"dtype": "float32", "names": ["PSM1.yaw", "PSM1.jaw"]},
        "observation.images.left": {"dtype": "video", "shape": [240, 320, 3]},
    },
}


def typed(lines: tuple[str, ...]) -> list[str]:
    """Give the command that a finding says to type next; its options must exist."""
    command = shlex.split(lines[-1].split("next: dvrk-cmaes ")[1])
    app.parse_args(command, exit_on_error=False, print_error=False)
    return command


def test_video_has_size_count_rate_and_the_command_that_imports_it(tmp_path: Path) -> None:
    write_video(tmp_path / "a b.mp4", code="mp4v")
    found = inspect_path(tmp_path / "a b.mp4")
    assert found.kind == "video"
    assert found.lines[0] == "{width} x {height} px, {images} images, {rate:.2f} a second, ".format(**found.read) + (
        f"{found.read['images'] / found.read['rate']:.1f} s"
    )
    assert typed(found.lines)[:4] == ["import", str(tmp_path / "a b.mp4"), "--camera", "camera.yaml"]


def test_video_beside_camera_and_readings_is_taken_for_a_recording(tmp_path: Path) -> None:
    write_video(tmp_path / "v.mp4", code="mp4v")
    for name in ("camera.yaml", "joints.csv"):
        (tmp_path / name).touch()
    assert typed(inspect_path(tmp_path / "v.mp4").lines) == ["track", str(tmp_path / "v.mp4")]


def test_file_that_is_no_video_is_refused(tmp_path: Path) -> None:
    (tmp_path / "v.mp4").write_text("anything")
    with pytest.raises(InputError, match=r"v\.mp4: expected a video"):
        inspect_path(tmp_path / "v.mp4")


def test_lerobot_set_has_counts_rate_videos_and_readings(tmp_path: Path) -> None:
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text(json.dumps(INFO))
    found = inspect_path(tmp_path)
    assert found.kind == "LeRobot data set"
    assert found.lines[0] == "codebase v2.1, episodes 4, frames 800"
    assert found.lines[1] == "videos: observation.images.left (320 x 240 px), 25 a second"
    assert found.lines[2] == "readings, a row a frame: PSM1.yaw, PSM1.jaw"
    assert typed(found.lines)[:4] == ["import", str(tmp_path), "--episode", "0"]


@pytest.mark.parametrize("features", [None, 3, [], "text"])
def test_lerobot_set_without_features_is_refused(tmp_path: Path, features: Any) -> None:
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text(json.dumps({**INFO, "features": features}))
    with pytest.raises(InputError, match=r"info\.json: features: expected an object, got"):
        inspect_path(tmp_path)


def test_odd_values_of_a_lerobot_set_are_unknown(tmp_path: Path) -> None:
    (tmp_path / "meta").mkdir()
    odd = {
        "observation.state": {"names": {"motors": ["yaw"], "x": 3}},
        "v": {"dtype": "video", "shape": [1]},
        "w": None,
    }
    (tmp_path / "meta" / "info.json").write_text(json.dumps({"fps": "fast", "features": odd}))
    assert inspect_path(tmp_path).lines[:3] == (
        "codebase without a version, episodes unknown, frames unknown",
        "videos: v (of unknown size), unknown a second",
        "readings, a row a frame: yaw",
    )


def test_session_says_its_clock_and_what_it_is_taken_for(tmp_path: Path) -> None:
    found = inspect_path(ROOT / "data" / "demo")
    assert [line for line in found.lines if line.startswith("clock: ")] == [
        "clock: none; 5 rows of readings, in the order of the frames"
    ]
    assert found.lines[-1].startswith("taken for frames of one arm and one camera; next: ")
    assert typed(found.lines) == ["calibrate", str(ROOT / "data" / "demo")]
