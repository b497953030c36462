"""Evaluation of followed recordings: errors, wrong statuses, losses, turns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.moving_worlds import MovingWorld, moving_world
from helpers.stereo_sessions import make_session_of_two_tools

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.results.tracked import TrackResult, TrackStatus
from dvrk_cmaes.runs.track_frames import TrackSettings
from dvrk_cmaes.track import Tracker


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world(12)


def result_of(world: MovingWorld, frame: int, status: TrackStatus = "ok", off_mm: float = 0.0) -> TrackResult:
    """Make a result whose tips are off by a distance along the camera's x axis."""
    truth = world.truths[frame]
    tips = truth.tips + np.array([off_mm * 1e-3, 0, 0])
    return TrackResult(world.time(frame), status, (), truth.camera_from_root, dict(truth.joints), None, tips, 0.1)


def figures(world: MovingWorld, results: list[TrackResult], visible: list[float]) -> dict[str, Any]:
    from measure.accuracy.track import Followed, truth_figures

    frames = tuple(FrameFiles(f"{k:04d}", None) for k in range(len(results)))
    golden = {
        "camera_from_base": world.base.tolist(),
        "frames": {
            files.name: {
                "T_camera_roll_link": world.truths[k].camera_from_root.tolist(),
                "joints": dict(world.truths[k].joints),
                "tips_camera_m": world.truths[k].tips.tolist(),
                "visible": visible[k],
            }
            for k, files in enumerate(frames)
        },
    }
    done = Followed(None, frames, results, Tracker(world.camera, world.body))  # type: ignore[arg-type]
    return truth_figures(done, golden)


@pytest.mark.usefixtures("scripts_on_path")
def test_errors_and_false_statuses_are_counted(world: MovingWorld) -> None:
    results = [result_of(world, k, off_mm=0.5) for k in range(12)]
    results[3] = result_of(world, 3, off_mm=5)
    results[4] = result_of(world, 4, "doubtful", off_mm=5)
    results[5] = result_of(world, 5, "doubtful", off_mm=0.1)
    found = figures(world, results, [1.0] * 12)
    assert found["tips, mm"] == pytest.approx(0.5)
    assert (found["ok and wrong"], found["false alarms"], found["wrong mode"]) == (1, 1, 0)
    assert found["worst"] == pytest.approx(5)


@pytest.mark.usefixtures("scripts_on_path")
def test_times_to_notice_and_to_come_back_are_counted(world: MovingWorld) -> None:
    visible = [1.0] * 2 + [0.0] * 6 + [1.0] * 4
    status: list[TrackStatus] = ["ok"] * 4 + ["lost"] * 6 + ["ok"] * 2
    found = figures(world, [result_of(world, k, status[k]) for k in range(12)], visible)
    assert (found["until said gone"], found["until back"]) == ("2", "2")


@pytest.mark.usefixtures("scripts_on_path")
def test_twin_is_counted_and_never_forgiven(world: MovingWorld) -> None:
    results = [result_of(world, k) for k in range(12)]
    for k in (6, 7):
        pose, _ = world.body.instrument.twin(world.truths[k].camera_from_root, world.truths[k].values)
        results[k] = replace(results[k], camera_from_root=pose)
    found = figures(world, results, [1.0] * 12)
    assert (found["wrong mode"], found["switches"]) == (2, 2)


@pytest.mark.usefixtures("scripts_on_path")
def test_arms_are_read_with_their_own_readings_and_truth(world: MovingWorld, tmp_path: Path) -> None:
    from measure.accuracy.track import recordings_to_follow

    folder = make_session_of_two_tools(tmp_path / "session", world.body)
    found = recordings_to_follow(folder, world.body.instrument, TrackSettings(EstimateConfig()))
    recordings = [recording for recording, _ in found]
    assert [one.name for one in recordings] == ["session PSM1", "session PSM2"]
    assert [one.golden.name for one in recordings] == ["golden_PSM1.json", "golden_PSM2.json"]
    first, second = (one.session.frames[0] for one in recordings)
    assert (first.label, second.label) == ((1,), (2,))
    assert first.readings != second.readings


@pytest.mark.usefixtures("scripts_on_path")
def test_session_of_one_arm_is_one_recording(world: MovingWorld) -> None:
    from measure.recordings import read_recordings

    (demo,) = read_recordings(bundled_path("demo"), world.body.instrument)
    assert (demo.name, demo.level, demo.arm, demo.golden.name) == ("demo", "demo", None, "golden.json")
