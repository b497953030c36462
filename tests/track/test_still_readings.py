"""Readings that stand still: frozen outer joints while the mask moves."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.pose.doubts import readings_frozen
from dvrk_cmaes.track.reading_buffer import frozen_frames, frozen_since

FRAMES = 30


def moving(count: int = FRAMES) -> np.ndarray:
    return np.linspace(0, 0.3, count)[:, None] * np.array([1.0, -1.0, 0.1, 2.0])


def centres(count: int = FRAMES) -> np.ndarray:
    return np.column_stack([np.linspace(100, 300, count), np.full(count, 200.0)])


def test_readings_that_move_are_not_frozen() -> None:
    assert not frozen_frames(moving(), centres(), 640).any()


def test_readings_that_stand_still_from_some_frame_on_while_the_mask_moves_are_frozen_there() -> None:
    outer = moving()
    outer[12:] = outer[12]
    assert np.flatnonzero(frozen_frames(outer, centres(), 640)).tolist() == [*range(12, FRAMES)]


def test_an_arm_at_rest_is_not_frozen() -> None:
    assert not frozen_frames(np.zeros((FRAMES, 4)), np.full((FRAMES, 2), 200.0), 640).any()


def test_reason_names_the_frame_since_which_readings_are_frozen() -> None:
    frozen = frozen_since(np.array([False, True, True, False, True]), ["a", "b", "c", "d", "e"])
    since = [text.split(":")[0] for name in frozen if (text := readings_frozen(name)) is not None]
    assert since == [*["readings frozen since frame b"] * 2, "readings frozen since frame e"]
