"""The rules for gaps: at which times a series of readings is known."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.joints.gaps import Gaps, continued, extrapolated, longest, unbroken, usual_spacing, within
from dvrk_cmaes.joints.interpolation import TimedReadings

STAMPS = (0.0, 1.0, 2.0, 6.0, 7.0)


def known(gaps: Gaps, *times: float, stamps: tuple[float, ...] = STAMPS) -> list[bool]:
    """Whether a series with readings at some times is known at others."""
    series = TimedReadings(("jaw",), np.array(stamps), np.zeros((len(stamps), 1)))
    return series.known(np.array(times), gaps).tolist()


RULES = {
    "within": within(1.0),
    "longest": longest(1.0),
    "usual_spacing": usual_spacing(np.array(STAMPS), 0.0),
    "unbroken": unbroken(1.0),
    "extrapolated": extrapolated(1.0),
    "continued": continued(1.0),
}


@pytest.mark.parametrize("gaps", RULES.values(), ids=RULES)
def test_every_rule_knows_readings_without_gaps_and_nothing_far_from_them(gaps: Gaps) -> None:
    assert known(gaps, 0.0, 0.5, 1.0, 1.5, 2.0, 6.5, 7.0) == [True] * 7
    assert known(gaps, -1.5, 8.5) == [False, False]


@pytest.mark.parametrize("gaps", RULES.values(), ids=RULES)
def test_single_reading_is_known_at_its_own_time(gaps: Gaps) -> None:
    assert known(gaps, -1.5, 0.0, 1.5, stamps=(0.0,)) == [False, True, False]


@pytest.mark.parametrize("gaps", RULES.values(), ids=RULES)
def test_without_readings_nothing_is_known(gaps: Gaps) -> None:
    assert known(gaps, 0.0, 1.0, stamps=()) == [False, False]


def test_within_both_readings_are_near_the_time_or_one_is_at_it() -> None:
    assert known(within(3.0), 2.9, 3.0, 4.0, 5.0, 5.1) == [False, True, True, True, False]
    assert known(within(0.1), 1.0, 1.05, 2.0, 6.0) == [True, False, True, True]
    assert known(within(3.0), -0.1, 7.1) == [False, False]


def test_within_is_exact_for_nanoseconds_since_1970() -> None:
    begin = 1_795_000_000_000_000_000
    series = TimedReadings(("jaw",), np.array([begin, begin + 7]), np.zeros((2, 1)))
    times = begin + np.arange(-1, 9)
    assert series.known(times, within(4)).tolist() == [False, True, False, False, True, True, False, False, True, False]


def test_longest_the_two_readings_are_near_each_other_or_one_is_at_the_time() -> None:
    assert known(longest(3.9), 2.0, 2.1, 4.0, 5.9, 6.0) == [True, False, False, False, True]
    assert known(longest(4.0), 2.1, 4.0, 5.9) == [True, True, True]
    assert known(longest(4.0), -0.1, 7.1) == [False, False]


def test_usual_spacing_the_longest_gap_is_three_median_spacings_and_not_below_the_least() -> None:
    assert known(usual_spacing(np.array(STAMPS), 0.0), 1.5, 2.0, 4.0, 6.0) == [True, True, False, True]
    assert known(usual_spacing(np.array(STAMPS), 4.0), 4.0) == [True]
    wider = (0.0, 1.0, 2.0, 5.0, 6.0)
    assert known(usual_spacing(np.array(wider), 0.0), 3.0, stamps=wider) == [True]


def test_usual_spacing_fewer_than_three_readings_have_no_gap() -> None:
    assert known(usual_spacing(np.array([0.0, 100.0]), 0.0), -1.0, 50.0, 101.0, stamps=(0.0, 100.0)) == [
        False,
        True,
        False,
    ]


def test_unbroken_a_longer_gap_includes_the_reading_that_ends_it() -> None:
    assert known(unbroken(3.9), 2.0, 2.1, 5.9, 6.0, 6.1) == [True, False, False, False, True]
    assert known(unbroken(4.0), 4.0, 6.0) == [True, True]
    assert known(unbroken(4.0), -0.1, 7.1) == [False, False]


def test_unbroken_a_longer_gap_after_the_first_reading_includes_it() -> None:
    assert known(unbroken(1.0), 0.0, 5.0, 5.5, stamps=(0.0, 5.0, 6.0)) == [False, False, True]


def test_extrapolated_readings_are_known_near_the_ends_and_as_by_longest_between() -> None:
    assert known(extrapolated(0.5), -0.6, -0.5, 7.5, 7.6) == [False, True, True, False]
    times = np.linspace(0, 7, 57)
    assert known(extrapolated(1.5), *times) == known(longest(1.5), *times)


def test_continued_readings_are_known_across_gaps_and_for_a_time_after_the_last() -> None:
    assert known(continued(0.5), -0.1, 0.0, 4.0, 7.0, 7.5, 7.6) == [False, True, True, True, True, False]
