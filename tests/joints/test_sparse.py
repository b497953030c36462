"""Readings between which the arm moves too far: the error of interpolation that they bound, and the reason."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.joints.interpolation import Sparseness
from dvrk_cmaes.pose.doubts import readings_too_sparse

DEPTH = 0.15  # m


def reason(stamps: np.ndarray, values: np.ndarray, time: float) -> str:
    """Why readings are too sparse at a time; empty if they are not."""
    return readings_too_sparse(Sparseness.of(stamps, values, time)) or ""


def swinging(rate: float, amplitude_deg: float, hertz: float, until: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """Readings of an arm whose yaw swings; ``rate`` is a second."""
    stamps = np.arange(0, until, 1 / rate)
    values = np.zeros((len(stamps), 4))
    values[:, 0] = yaw(stamps, amplitude_deg, hertz)
    values[:, 2] = DEPTH
    return stamps, values


def yaw(times: np.ndarray | float, amplitude_deg: float, hertz: float) -> np.ndarray:
    return np.asarray(np.deg2rad(amplitude_deg) * np.sin(2 * np.pi * hertz * np.asarray(times)))


@pytest.mark.parametrize("rate", [5.0, 8.0, 9.0, 20.0])
def test_error_of_a_straight_line_is_stated_to_a_third_nearly_always(rate: float) -> None:
    stamps, values = swinging(rate, 10.0, 0.7)
    times = np.linspace(stamps[2], stamps[-3], 400)
    off = np.abs(np.interp(times, stamps, values[:, 0]) - yaw(times, 10.0, 0.7))
    stated = np.array([Sparseness.of(stamps, values, time).error[0] for time in times])
    assert np.mean(off <= 1.33 * stated + 1e-6) > 0.9
    assert np.median(stated[off > 0] / off[off > 0]) < 2


def test_too_sparse_readings_are_a_reason_with_their_spacing_and_the_turn_between_them() -> None:
    stamps, values = swinging(1 / 0.11, 20.0, 1.4)
    reasons = {reason(stamps, values, float(time) + 0.055) for time in stamps[2:-3]}
    assert "readings too sparse: every 110 ms, the arm turns 18 deg between them" in reasons
    assert all(not text or text.startswith("readings too sparse: every 110 ms") for text in reasons)
    slow = swinging(1 / 0.11, 20.0, 0.1)
    assert {reason(*slow, float(time) + 0.055) for time in slow[0][2:-3]} == {""}


def test_dense_readings_are_not_too_sparse_whatever_a_single_one_says() -> None:
    stamps, values = swinging(100.0, 5.0, 0.7)
    values[50, 0] += 0.5
    assert reason(stamps, values, 0.503) == ""


def test_two_readings_of_almost_the_same_time_state_no_boundless_error() -> None:
    stamps = np.array([0.0, 0.1, 0.2, 0.2 + 1e-12, 0.4])
    values = np.outer([0.0, 0.01, 0.02, 0.03, 0.04], np.ones(4))
    found = Sparseness.of(stamps, values, 0.3)
    assert found.error.max() == 1.0
    assert found.between.startswith("every 200 ms")
