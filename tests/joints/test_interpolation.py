"""Interpolation of readings over time; the rules for gaps are in test_gaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvrk_cmaes.joints.gaps import extrapolated, longest, within
from dvrk_cmaes.joints.interpolation import Curve, TimedReadings, smooth_spline, straight_line, weighted_mean

MS = 1_000_000


def readings(times: list[int], values: list[list[float]], joints: tuple[str, ...] = ("jaw",)) -> TimedReadings:
    return TimedReadings.of("/jaw", joints, times, values)


def at(series: TimedReadings, time: int, tolerance: int) -> list[float] | None:
    """Interpolate at one time; None where readings are not known."""
    times, gaps = np.array([time]), within(tolerance)
    return series.at(times, gaps, weighted_mean)[0].tolist() if series.known(times, gaps)[0] else None


def distances(series: TimedReadings, time: int) -> tuple[int, int]:
    nearest, farther = series.distances(np.array([time]))
    return int(nearest[0]), int(farther[0])


def test_no_extrapolation() -> None:
    jaw = readings([0, 10 * MS], [[1.0], [2.0]])
    assert at(jaw, -1, 10 * MS) is None
    assert at(jaw, 10 * MS + 1, 10 * MS) is None


def test_distances_are_those_of_the_nearest_and_of_the_farther_reading_used() -> None:
    jaw = readings([0, 10 * MS, 20 * MS], [[1.0], [2.0], [3.0]])
    assert distances(jaw, 4 * MS) == (4 * MS, 6 * MS)
    assert distances(jaw, 10 * MS) == (0, 0)
    assert (distances(jaw, -7)[0], distances(jaw, 20 * MS + 3)[0]) == (7, 3)


def test_nanoseconds_since_1970_are_resolved() -> None:
    begin = 1_795_000_000_000_000_000
    jaw = readings([begin, begin + 4], [[0.0], [4.0]])
    assert at(jaw, begin + 1, 10) == [1.0]
    assert distances(jaw, begin + 1) == (1, 3)


@given(
    st.lists(st.integers(-(10**12), 10**12), min_size=1, max_size=20, unique=True),
    st.integers(-(10**12), 10**12),
    st.integers(0, 10**12),
)
def test_value_exists_only_between_near_readings(times: list[int], time: int, tolerance: int) -> None:
    jaw = readings(times, [[t / 1e9] for t in times])
    found, (nearest, farther) = at(jaw, time, tolerance), distances(jaw, time)
    before, after = [t for t in times if t <= time], [t for t in times if t >= time]
    exact = time in times
    near = bool(before and after) and max(time - max(before), min(after) - time) <= tolerance
    assert (found is not None) == (exact or near)
    if found is not None:
        assert abs(found[0] - time / 1e9) <= 1e-6
        assert farther <= tolerance
    assert nearest == min(abs(t - time) for t in times)


@pytest.mark.parametrize("curve", [weighted_mean, straight_line, smooth_spline])
def test_every_curve_follows_a_steady_motion(curve: Curve) -> None:
    stamps = np.cumsum(np.random.default_rng(1).uniform(0.7, 1.3, 20))
    series = TimedReadings(("yaw", "jaw"), stamps, np.stack([stamps, 3 - 0.1 * stamps], axis=1))
    times = np.linspace(stamps[0], stamps[-1], 101)
    np.testing.assert_allclose(series.at(times, longest(2.0), curve), np.stack([times, 3 - 0.1 * times], axis=1))


@pytest.mark.parametrize("curve", [weighted_mean, straight_line])
def test_readings_beyond_the_ends_are_held_or_change_by_a_rate(curve: Curve) -> None:
    series = TimedReadings(("yaw", "jaw"), np.array([1.0, 2.0]), np.array([[1.0, 5.0], [3.0, 5.0]]))
    times = np.array([-0.1, 0.0, 1.5, 3.0, 3.1])
    held = series.at(times, extrapolated(1.0), curve)
    np.testing.assert_array_equal(held, [[np.nan] * 2, [1.0, 5.0], [2.0, 5.0], [3.0, 5.0], [np.nan] * 2])
    moving = series.at(times, extrapolated(1.0), curve, np.array([2.0, np.nan]))
    np.testing.assert_array_equal(moving[:, 0], [np.nan, -1.0, 2.0, 5.0, np.nan])
    assert np.isnan(moving[:, 1]).all()
