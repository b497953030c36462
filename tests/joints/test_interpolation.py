"""Interpolation of readings over time, within a tolerance and without extrapolation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvrk_cmaes.joints.interpolation import Gaps, TimedReadings, interpolated

MS = 1_000_000


def readings(times: list[int], values: list[list[float]], joints: tuple[str, ...] = ("jaw",)) -> TimedReadings:
    return TimedReadings.of("/jaw", joints, times, values)


def value(found: tuple[np.ndarray, int] | None) -> tuple[list[float], int] | None:
    return None if found is None else (found[0].tolist(), found[1])


def test_interpolation_is_linear() -> None:
    jaw = readings([0, 10 * MS], [[1.0, 0.0], [2.0, -1.0]], ("jaw", "roll"))
    found = value(jaw.at(4 * MS, 10 * MS))
    assert found is not None
    assert found[0] == pytest.approx([1.4, -0.4])
    assert found[1] == 6 * MS


def test_exact_time_gives_exact_reading() -> None:
    jaw = readings([0, 10 * MS, 900 * MS], [[1.0], [2.0], [5.0]])
    assert value(jaw.at(10 * MS, 1)) == ([2.0], 0)
    assert value(jaw.at(900 * MS, 1)) == ([5.0], 0)


def test_no_extrapolation() -> None:
    jaw = readings([0, 10 * MS], [[1.0], [2.0]])
    assert jaw.at(-1, 10 * MS) is None
    assert jaw.at(10 * MS + 1, 10 * MS) is None
    assert (jaw.distance(-7), jaw.distance(10 * MS + 3), jaw.distance(4 * MS)) == (7, 3, 4 * MS)


def test_both_neighbours_must_be_within_tolerance() -> None:
    jaw = readings([0, 100 * MS], [[1.0], [2.0]])
    assert jaw.at(10 * MS, 90 * MS) is not None
    assert jaw.at(10 * MS, 90 * MS - 1) is None


def test_unknown_reading_stays_unknown() -> None:
    found = readings([0, 10], [[1.0, 3.0], [np.nan, 4.0]], ("jaw", "roll")).at(5, 10)
    assert found is not None
    assert np.isnan(found[0][0])
    assert found[0][1] == 3.5


def test_readings_are_sorted_and_last_duplicate_is_used() -> None:
    jaw = readings([20, 0, 20, 10], [[1.0], [2.0], [3.0], [4.0]])
    assert jaw.times.tolist() == [0, 10, 20]
    assert jaw.values.ravel().tolist() == [2.0, 4.0, 3.0]


def test_nanoseconds_since_1970_are_resolved() -> None:
    begin = 1_795_000_000_000_000_000
    assert value(readings([begin, begin + 4], [[0.0], [4.0]]).at(begin + 1, 10)) == ([1.0], 3)


@given(
    st.lists(st.integers(-(10**12), 10**12), min_size=1, max_size=20, unique=True),
    st.integers(-(10**12), 10**12),
    st.integers(0, 10**12),
)
def test_value_exists_only_between_near_readings(times: list[int], time: int, tolerance: int) -> None:
    jaw = readings(times, [[t / 1e9] for t in times])
    found = jaw.at(time, tolerance)
    before, after = [t for t in times if t <= time], [t for t in times if t >= time]
    exact = time in times
    near = bool(before and after) and max(time - max(before), min(after) - time) <= tolerance
    assert (found is not None) == (exact or near)
    if found is not None:
        assert abs(found[0][0] - time / 1e9) <= 1e-6
        assert found[1] <= tolerance
    assert jaw.distance(time) == min(abs(t - time) for t in times)


# rules for gaps

STAMPS, VALUES = np.array([0.0, 1.0, 2.0, 6.0]), np.array([0.0, 10.0, 20.0, 60.0])


def known(gaps: Gaps, *times: float) -> list[bool]:
    """Tell which times have a value; where they have one, it is ten times the time."""
    at = interpolated(STAMPS, VALUES, np.array(times), gaps)
    expected = 10 * np.array(times)
    np.testing.assert_allclose(at[~np.isnan(at)], expected[~np.isnan(at)])
    return (~np.isnan(at)).tolist()


def test_without_a_rule_all_gaps_are_interpolated_and_nothing_beyond_the_ends() -> None:
    assert known(Gaps(), -0.1, 0.0, 0.5, 4.0, 6.0, 6.1) == [False, True, True, True, True, False]


def test_readings_that_are_too_far_apart_are_not_interpolated() -> None:
    assert known(Gaps.of_length(1.0), 0.5, 1.0, 2.0, 2.1, 5.9, 6.0) == [True, True, True, False, False, True]


def test_both_readings_within_a_tolerance_are_asked_for() -> None:
    assert known(Gaps.within(3.0), 0.5, 2.5, 3.0, 4.0, 5.0) == [True, False, True, True, True]
    assert known(Gaps.within(0.9), 0.05, 0.5) == [False, True]


@pytest.mark.parametrize(("least", "wide"), [(0.0, False), (5.0, True)])
def test_gaps_beyond_the_usual_spacing_are_not_interpolated_unless_they_are_short(least: float, wide: bool) -> None:
    gaps = Gaps.beyond_usual(STAMPS, 3.0, least)  # the median spacing is 1
    assert known(gaps, 1.5, 4.0) == [True, wide]


def test_two_readings_have_no_usual_spacing() -> None:
    assert Gaps.beyond_usual(STAMPS[:2], 3.0, 0.0) == Gaps()


def test_no_reading_gives_no_value() -> None:
    assert np.isnan(interpolated(STAMPS[:0], VALUES[:0], np.array([1.0]), Gaps())).all()
