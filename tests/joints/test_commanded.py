"""Joints whose readings never move while the arm does: which they are, what is said of them, and how they count."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes import EstimateConfig
from dvrk_cmaes.config import ReadingSigmas, SessionConfig
from dvrk_cmaes.joints.commanded import commanded_in, commanded_joints, describe_commanded, with_commanded

FRAMES = 30
NAMES = ("wrist_pitch", "wrist_yaw", "jaw")


def moving() -> np.ndarray:
    return np.linspace(0, 0.3, FRAMES)[:, None] * np.array([1.0, -1.0, 0.1, 2.0])


def test_a_joint_that_is_constant_while_the_arm_moves_is_commanded() -> None:
    joints = np.column_stack([np.full(FRAMES, 0.4), np.linspace(0, 1, FRAMES), np.full(FRAMES, np.nan)])
    assert commanded_joints(moving(), joints, NAMES) == ["wrist_pitch"]


def test_joints_of_an_arm_at_rest_are_not_commanded() -> None:
    assert commanded_joints(np.zeros((FRAMES, 4)), np.zeros((FRAMES, 3)), NAMES) == []


def test_readings_that_differ_by_the_noise_of_an_encoder_are_measured() -> None:
    joints = np.full((FRAMES, 3), 0.4)
    joints[::2] += 1e-4
    assert commanded_joints(moving(), joints, NAMES) == []


def test_few_frames_do_not_tell_a_commanded_joint() -> None:
    assert commanded_joints(moving()[:4], np.zeros((4, 3)), NAMES) == []


def test_readings_by_frame_may_lack_joints() -> None:
    rows = [dict(zip(("yaw", "pitch", "insertion", "roll"), outer.tolist(), strict=True)) for outer in moving()]
    assert commanded_in([row | {"wrist_yaw": 0.0} for row in rows], NAMES) == ["wrist_yaw"]
    assert commanded_in(rows, NAMES) == []
    assert commanded_in([], NAMES) == []


def test_one_warning_names_all_commanded_joints() -> None:
    text = describe_commanded(NAMES)
    assert text.startswith("wrist readings never move: wrist_pitch, wrist_yaw and jaw constant while the arm moves")
    assert describe_commanded(["jaw"]).startswith("jaw readings never move: jaw constant")


def test_commanded_readings_count_with_twice_the_usual_standard_deviation() -> None:
    config = with_commanded(EstimateConfig(), NAMES, NAMES)
    assert config.readings == ReadingSigmas(wrist_pitch_deg=20, wrist_yaw_deg=20, jaw_deg=30)
    assert (config.session.wrist_deg, config.session.jaw_deg) == (7.0, 10.0)
    assert with_commanded(config, NAMES, NAMES) == config


def test_measured_joints_keep_their_standard_deviations() -> None:
    config = with_commanded(EstimateConfig(), ["wrist_pitch"], NAMES)
    assert config == EstimateConfig(readings=ReadingSigmas(wrist_pitch_deg=20))
    assert with_commanded(EstimateConfig(), [], NAMES) == EstimateConfig()


def test_standard_deviations_that_the_user_has_chosen_are_kept() -> None:
    own = EstimateConfig(readings=ReadingSigmas(jaw_deg=3), session=SessionConfig(jaw_deg=1))
    assert with_commanded(own, ["jaw"], NAMES) == own
