"""Synthetic recordings: smooth motion, late images, errors of cables, and the share of the jaws that can be seen."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.moving_worlds import SMALL

from dvrk_cmaes import Body, read_session
from dvrk_cmaes.synth.cable_motion import draw_cables
from dvrk_cmaes.synth.levels import LEVELS, LevelName
from dvrk_cmaes.synth.moving_arm import MOTION_LEVELS, cable_joints, level_offsets, moving_arm, read_moving
from dvrk_cmaes.synth.recording import write_recording
from dvrk_cmaes.synth.session import SessionPlan


def plan(body: Body, level: LevelName, frames: int = 6, seed: int = 1) -> SessionPlan:
    return SessionPlan(body, SMALL, LEVELS[level], "video", frames, seed, {})


@pytest.fixture(scope="module")
def recording(bundled_body: Body, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("synth") / "recording"
    write_recording(folder, plan(bundled_body, "easy"))
    return folder


def test_recording_is_a_session_with_times(recording: Path) -> None:
    session = read_session(recording)
    series = session.reading_series()
    assert [files.name for files in session.frames] == [f"{k:04d}" for k in range(6)]
    assert series is not None
    assert (series.unit, series.interval) == ("s", pytest.approx(1 / 30, abs=1e-6))


def test_truth_states_what_can_be_seen(recording: Path) -> None:
    golden = json.loads((recording / "golden.json").read_text(encoding="utf-8"))
    assert np.array(golden["camera_from_base"]).shape == (4, 4)
    assert all(0.9 <= frame["visible"] <= 1 for frame in golden["frames"].values())


def test_motion_is_smooth_and_in_view(bundled_body: Body) -> None:
    base, truths, _ = moving_arm(bundled_body, SMALL, np.random.default_rng(0), 90, MOTION_LEVELS["easy"])
    places = np.array([truth.camera_from_root[:3, 3] for truth in truths])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 3e-3
    assert np.linalg.norm(np.diff(places, n=2, axis=0), axis=1).max() < 2e-4
    pixels = SMALL.project(np.array([truth.tips for truth in truths]))
    assert ((pixels > 0) & (pixels < [SMALL.width, SMALL.height])).all()
    assert np.allclose(base[3], [0, 0, 0, 1])


def test_late_images_show_earlier_readings(bundled_body: Body) -> None:
    level = replace(MOTION_LEVELS["hard"], leaves=False, lag=3.0)
    rng = np.random.default_rng(4)
    _, truths, _ = moving_arm(bundled_body, SMALL, rng, 60, level)
    read, true = read_moving(truths, rng, level)["yaw"], np.array([truth.outer["yaw"] for truth in truths])
    assert np.std(read[:-3] - true[3:]) < 0.002
    assert np.std(read[:-3] - true[3:]) < 0.2 * np.std(read - true)


def test_arm_of_hard_level_leaves_the_view_and_comes_back(bundled_body: Body) -> None:
    _, truths, _ = moving_arm(bundled_body, SMALL, np.random.default_rng(2), 120, MOTION_LEVELS["hard"])
    inside = []
    for truth in truths:
        pixels = SMALL.project(truth.tips) if (truth.tips[:, 2] > 0).all() else np.full((2, 2), -1.0)
        inside.append(bool(((pixels > 0) & (pixels < [SMALL.width, SMALL.height])).all()))
    assert inside[0]
    assert inside[-1]
    assert not all(inside)


def test_joints_follow_their_readings_by_the_cables_of_a_real_arm(bundled_body: Body) -> None:
    level, names = replace(MOTION_LEVELS["medium"], lag=0.0), cable_joints(bundled_body)
    rng = np.random.default_rng(5)
    cables = draw_cables(names, level_offsets(names, level), rng)
    _, truths, paths = moving_arm(bundled_body, SMALL, rng, 120, level, cables)
    read = read_moving(truths, rng, level, cables, paths)
    errors = {name: np.array([{**truth.outer, **truth.joints}[name] for truth in truths]) - read[name] for name in read}
    assert np.degrees(np.std(errors["wrist_pitch"])) > 2
    assert np.degrees(np.std(errors["roll"])) < np.degrees(np.std(errors["wrist_pitch"]))
    assert np.degrees(np.std(errors["yaw"])) < 0.2
