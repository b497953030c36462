"""Prediction of the state: how much less certain it becomes from one image to the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dvrk_cmaes.config import EstimateConfig, TrackConfig
from dvrk_cmaes.joints.cables import CableModel
from dvrk_cmaes.track.motion import Anchor, MotionModel
from dvrk_cmaes.track.reading_buffer import ReadingAt
from dvrk_cmaes.track.start import unknown_state
from dvrk_cmaes.track.state import Layout

NAMES = ("wrist_pitch", "wrist_yaw", "jaw")
CONFIG = TrackConfig()
AT = Layout(3)
ZERO, ZEROS = np.zeros(4), np.zeros((4, 4))
CABLES = CableModel(
    ("roll", *NAMES), ZERO, ZERO, ZEROS, ZEROS, ZERO, np.ones(4), wander=np.full(4, 0.02), seconds=np.full(4, 40.0),
    noise=ZERO,
)  # fmt: skip
BEFORE = Anchor(
    np.array([0.1, -0.2, 0.15, 0.5]),
    np.array([0.2, 0.1, 0.6]),
    np.zeros(4),
    np.zeros(3),
    outer_read=True,
    joint_read=np.ones(3, np.bool_),
    based=True,
)
ELAPSED = 1 / 30


def growth(anchor: Anchor = BEFORE, cables: CableModel | None = None, lag_std: float = 0.0) -> np.ndarray:
    """Give what a prediction adds to the variances of the state."""
    motion = MotionModel(CONFIG, 3, "classic", 0.4162, cables)
    state = unknown_state(EstimateConfig(), motion, BEFORE, NAMES, 0.0)
    state = replace(state, covariance=np.zeros_like(state.covariance))
    return np.diag(motion.predict(state, BEFORE, anchor, ELAPSED, lag_std)[0].covariance)


def bent(by: float) -> Anchor:
    """Give the readings after roll and all joints moved."""
    return replace(BEFORE, outer=BEFORE.outer + np.array([0, 0, 0, by]), joints=BEFORE.joints + by)


def test_readings_that_stand_still_tell_where_the_joints_were_and_not_how_they_move() -> None:
    joints = np.array([0.3, np.nan, 0.7])
    reading = ReadingAt(BEFORE.outer, joints, np.ones(4), np.ones(3), still=True)
    anchor = BEFORE.then(reading, moving=False)
    assert not anchor.joint_read.any()
    np.testing.assert_array_equal(anchor.joint_rate, 0)
    np.testing.assert_array_equal(anchor.known, joints)
    np.testing.assert_array_equal(BEFORE.then(reading).known, joints)


def test_offsets_at_rest_wander() -> None:
    drift = np.deg2rad(CONFIG.offset_drift_deg) ** 2 * ELAPSED
    assert growth()[AT.roll] == pytest.approx(drift)
    assert growth()[AT.offsets] == pytest.approx(drift)


def test_play_adds_to_the_variance_of_a_moving_joints_offset_in_proportion_to_its_way() -> None:
    near, far = (growth(bent(by)) - growth() for by in (0.1, -0.2))
    assert near[AT.roll] == pytest.approx(np.deg2rad(CONFIG.offset_play_deg) * 0.1)
    assert near[AT.offsets] == pytest.approx(np.deg2rad(CONFIG.offset_play_deg) * 0.1)
    np.testing.assert_allclose(far[AT.offsets], 2 * near[AT.offsets])


def test_a_model_of_the_cables_leaves_less_play() -> None:
    without = growth(bent(0.1)) - growth()
    left = growth(bent(0.1), CABLES) - growth(BEFORE, CABLES)
    assert (left[AT.offsets] < 0.5 * without[AT.offsets]).all()
    assert left[AT.roll] < 0.5 * without[AT.roll]
    assert (left[AT.offsets] > 0).all()


def test_a_model_of_the_cables_has_the_wander_that_it_states() -> None:
    added = growth(BEFORE, CABLES)[AT.offsets] - growth()[AT.offsets]
    # of the change of an Ornstein-Uhlenbeck process in a time far below its correlation time
    assert added == pytest.approx(2 * 0.02**2 * ELAPSED / 40.0)


def test_unknown_lag_makes_readings_less_certain_as_their_rate_changes() -> None:
    faster = replace(BEFORE, outer_rate=np.array([0, 0, 0, 0.5]), joint_rate=np.array([0.1, 0.2, 0.4]))
    added = growth(faster, lag_std=0.02) - growth(faster)
    assert added[AT.roll] == pytest.approx((0.02 * 0.5) ** 2)
    assert added[AT.offsets] == pytest.approx(np.square(0.02 * np.array([0.1, 0.2, 0.4])))


def test_slack_is_forgotten_in_time() -> None:
    """The variance of what readings do not explain stays the same: what is forgotten comes anew."""
    motion = MotionModel(CONFIG, 3, "classic", 0.4162)
    state = unknown_state(EstimateConfig(), motion, BEFORE, NAMES, 0.0)
    after, _ = motion.predict(state, BEFORE, BEFORE, ELAPSED, 0.0)
    np.testing.assert_allclose(after.covariance[AT.slack, AT.slack], state.covariance[AT.slack, AT.slack])
