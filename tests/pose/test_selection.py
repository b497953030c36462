"""Which poses of a joint refinement continue."""

from __future__ import annotations

from dvrk_cmaes.pose.refine.selection import ALL, Selection

SCORES = [30.0, 10.0, 200.0, 12.0]
OUTLINES = [29.0, 9.0, 190.0, 11.0]


def test_all_continue_by_default_best_first() -> None:
    assert ALL.continuing(SCORES, OUTLINES, 4) == [1, 3, 0, 2]


def test_poses_far_from_the_best_stop() -> None:
    assert Selection(gap=15.0).continuing(SCORES, OUTLINES, 4) == [1, 3]


def test_an_outline_as_good_as_the_best_continues_though_readings_contradict_it() -> None:
    contradicted = [29.0, 9.0, 8.0, 11.0]
    assert Selection(gap=15.0).continuing(SCORES, contradicted, 4) == [1, 3, 2]


def test_the_least_number_continues_however_far_they_are() -> None:
    assert Selection(gap=1.0, least=3).continuing(SCORES, OUTLINES, 4) == [1, 3, 0]


def test_the_share_that_is_left_limits_the_number() -> None:
    assert Selection().continuing(SCORES, OUTLINES, 1.6) == [1, 3]
