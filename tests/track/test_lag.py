"""Lag of the images found from poses and readings alone."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.session_worlds import BASE

from dvrk_cmaes.geometry import moved
from dvrk_cmaes.instrument.arm import base_from_root
from dvrk_cmaes.track.lag import LAGS, LagSearch

COVARIANCE = np.diag(np.square([1e-4, 1e-4, 3e-4, 5e-3, 5e-3, 5e-2]))


def outer_at(times: np.ndarray, speed: float = 1.0) -> np.ndarray:
    """Readings of a moving arm at times (L,), (L, 4)."""
    t = speed * times
    return np.stack([0.1 * np.sin(3 * t), 0.1 * np.cos(2.3 * t), 0.14 + 0.01 * np.sin(2 * t), 0.6 * np.sin(t)], axis=-1)


def searched(lag: float, *, speed: float = 1.0, frames: int = 90, noise: float = 1.0) -> LagSearch:
    """Give a search that has the poses of images that are late, with ``noise`` times the errors that they state."""
    rng, search = np.random.default_rng(1), LagSearch(base_from_root)
    for time in 1.0 + np.arange(frames) / 30:
        pose = BASE @ base_from_root(outer_at(np.array([time - lag]), speed)[0])
        off = noise * rng.standard_normal(6) * np.sqrt(np.diag(COVARIANCE))
        search.add(moved(pose, off), COVARIANCE[:6, :6], outer_at(time - LAGS, speed))
    return search


@pytest.mark.parametrize("lag", [-0.03, 0.0, 0.05, 0.133, 0.2])
def test_lag_is_found_to_a_fraction_of_a_frame(lag: float) -> None:
    found = searched(lag).search(BASE)
    assert found is not None
    assert found.seconds == pytest.approx(lag, abs=4 * found.std)
    assert found.std < 0.01


def test_standard_deviation_allows_for_errors_that_successive_poses_share() -> None:
    """It is that of the stated errors, for poses of which a dozen count as one, and grows only with larger errors."""
    exact, usual, wrong = (searched(0.1, noise=noise).search(BASE) for noise in (0.0, 1.0, 8.0))
    assert exact is not None
    assert usual is not None
    assert usual.std == pytest.approx(exact.std, rel=0.02)
    assert wrong is None or wrong.std > 1.5 * exact.std


def test_guess_of_base_does_not_matter() -> None:
    found = searched(0.1).search(moved(BASE, [0.002, -0.002, 0.002, 0.02, 0.02, 0.0]))
    assert found is not None
    assert found.seconds == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_arm_that_hardly_moves_tells_no_lag(speed: float) -> None:
    assert searched(0.1, speed=speed).search(BASE) is None


def test_search_goes_on_from_its_checkpoint() -> None:
    search, other = searched(0.1), LagSearch(base_from_root)
    other.restore(search.checkpoint())
    assert other.search(BASE) == search.search(BASE)
    search.clear()
    assert not search.due
