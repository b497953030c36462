"""Play of joints: how far they stay behind their readings."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.joints.cables import play_of

WIDTH = np.array([0.2])


def test_a_joint_stands_still_while_its_reading_moves_within_the_play() -> None:
    readings = np.array([[0.0], [0.15], [-0.15], [0.1]])
    play = play_of(readings, WIDTH)
    np.testing.assert_allclose(readings + play.wide, 0.0, atol=1e-15)


def test_a_joint_that_is_pulled_follows_half_the_play_behind_and_on_its_way_back_stays_first() -> None:
    readings = np.array([[0.0], [1.0], [0.9], [0.5]])
    play = play_of(readings, WIDTH)
    np.testing.assert_allclose((readings + play.wide)[:, 0], [0.0, 0.8, 0.8, 0.7])
    np.testing.assert_allclose((readings + play.narrow)[:, 0], [0.0, 1 - 0.2 / 3, 0.9 + 0.1 / 3, 0.5 + 0.2 / 3])


def test_no_joint_stays_farther_behind_than_its_play() -> None:
    rng = np.random.default_rng(0)
    readings = np.cumsum(rng.normal(0, 0.1, (200, 3)), axis=0)
    readings[rng.random((200, 3)) < 0.1] = np.nan
    width = np.array([0.1, 0.2, 0.3])
    whole = play_of(readings, width)
    assert (np.abs(whole.wide).max(axis=0) <= width + 1e-12).all()
