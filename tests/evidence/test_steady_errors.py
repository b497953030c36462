"""Stretches of contour that are off together: found where one side is off at length, not in noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from dvrk_cmaes.evidence.steady_errors import steady_stretches

COUNT = 1000
CONTOUR = np.stack([np.arange(COUNT), np.zeros(COUNT)], axis=1).astype(float)


def noise(sigma: float, seed: int = 0) -> np.ndarray:
    smooth = gaussian_filter1d(np.random.default_rng(seed).standard_normal(COUNT), 6, mode="wrap")
    return sigma * smooth / smooth.std()


@pytest.mark.parametrize("sigma", [0.3, 1.0, 2.0])
def test_shadow_is_found_and_little_else(sigma: float) -> None:
    distances = noise(sigma)
    distances[300:400] += 8 * max(sigma, 0.5)
    found = steady_stretches(CONTOUR, distances)
    assert found[305:395].mean() > 0.95
    assert np.delete(found, np.arange(280, 420)).mean() < 0.03


def test_no_contour_has_no_stretch() -> None:
    assert steady_stretches(np.zeros((0, 2)), np.zeros(0)).shape == (0,)


def test_single_points_are_no_stretch() -> None:
    distances = noise(0.3)
    distances[::50] = 10
    assert not steady_stretches(CONTOUR, distances).any()


def test_alternating_sides_are_no_stretch() -> None:
    distances = noise(0.3)
    distances[500:520] = 10 * (-1.0) ** np.arange(20)
    assert not steady_stretches(CONTOUR, distances)[500:520].any()


def test_gap_in_contour_ends_stretch() -> None:
    distances = noise(0.3)
    distances[500:508] = 10
    apart = CONTOUR + np.where(np.arange(COUNT) >= 504, 50, 0)[:, None]
    assert steady_stretches(CONTOUR, distances)[500:508].all()
    assert not steady_stretches(apart, distances)[500:508].any()
