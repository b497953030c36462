"""The choice of keyframes: well in view, with readings, and spread over time and poses."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.track.keyframes import MaskShape, choose_keyframes, has_outer_joints

NAMES = ("yaw", "pitch", "insertion", "roll", "wrist_pitch")


def box(rows: slice, columns: slice) -> MaskShape:
    mask = np.zeros((100, 100), np.bool_)
    mask[rows, columns] = True
    return MaskShape.of(mask)


def test_shape_of_a_mask_tells_area_and_share_on_the_border() -> None:
    inside, cut = box(slice(10, 30), slice(10, 30)), box(slice(0, 20), slice(10, 30))
    assert inside == MaskShape(400.0, 0.0)
    assert cut.area == 400
    assert 0.2 < cut.on_border < 0.35
    assert box(slice(0, 0), slice(0, 0)) == MaskShape(0.0, 1.0)


def test_all_usable_frames_are_chosen_if_they_are_few() -> None:
    usable = np.array([True, False, True, True])
    assert choose_keyframes(usable, np.arange(4.0), NAMES, np.zeros((4, 5)), 3) == [0, 2, 3]


def test_frames_at_rest_are_spread_over_time() -> None:
    chosen = choose_keyframes(np.ones(101, np.bool_), np.arange(101.0), NAMES, np.zeros((101, 5)), 11)
    assert chosen[0] == 0
    assert chosen[-1] == 100
    assert np.diff(chosen).max() <= 15


def test_a_short_motion_gets_more_frames_than_its_share_of_time() -> None:
    readings = np.zeros((200, 5))
    readings[100:120, 0] = np.linspace(0, 0.8, 20)
    readings[120:, 0] = 0.8
    chosen = np.array(choose_keyframes(np.ones(200, np.bool_), np.arange(200.0), NAMES, readings, 20))
    assert ((chosen >= 100) & (chosen < 120)).sum() >= 6


def test_frames_without_a_reading_of_an_outer_joint_are_told() -> None:
    readings = np.zeros((3, 5))
    readings[1, 2] = np.nan
    readings[2, 4] = np.nan
    assert has_outer_joints(NAMES, readings).tolist() == [True, False, True]
    assert not has_outer_joints(NAMES[1:], readings[:, 1:]).any()
