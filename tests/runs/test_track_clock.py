"""Readings at the times of images: interpolated, and unknown in gaps and beyond the ends."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.runs.track_clock import TrackClock


def clock(*rows: tuple[float, dict[str, float]]) -> TrackClock:
    return TrackClock({}, "s", 0.1, rows)


def test_readings_are_interpolated_between_those_before_and_after() -> None:
    found = clock((0.0, {"jaw": 0.0, "roll": 1.0}), (0.1, {"jaw": 1.0}), (0.2, {"roll": 3.0}))
    read = found.readings_at(np.array([0.0, 0.05, 0.1, 0.2]), gap=0.5)
    np.testing.assert_allclose(read["jaw"], [0, 0.5, 1, np.nan])
    np.testing.assert_allclose(read["roll"], [1, 1.5, 2, 3])


def test_readings_are_unknown_in_gaps_and_before_the_first() -> None:
    found = clock((0.0, {"jaw": 0.0}), (0.1, {"jaw": 1.0}), (0.9, {"jaw": 2.0}), (1.0, {"jaw": 3.0}))
    read = found.readings_at(np.array([-0.1, 0.05, 0.5, 0.95]), gap=0.15)["jaw"]
    np.testing.assert_allclose(read, [np.nan, 0.5, np.nan, 2.5])


def test_one_reading_is_known_at_its_own_time() -> None:
    read = clock((0.5, {"jaw": 1.0})).readings_at(np.array([0.4, 0.5]), gap=1.0)
    np.testing.assert_allclose(read["jaw"], [np.nan, 1.0])


def test_clock_without_readings_has_none() -> None:
    assert clock().readings_at(np.array([0.0]), gap=1.0) == {}
