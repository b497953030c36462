"""Estimation of the noise of a mask's outline, and bilinear sampling of images."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes import Camera
from dvrk_cmaes.evidence.outline_noise import distances_to, measure_noise, sampled, signed_distance
from dvrk_cmaes.evidence.shaft_edges import find_contour

CAMERA = Camera(320, 240, 400, 400, 160, 120)


def disc(radius: float) -> np.ndarray:
    v, u = np.mgrid[:240, :320]
    return np.hypot(u - 150.3, v - 119.6) < radius


@pytest.mark.parametrize("centre", [(150.0, 120.0), (3.0, 5.0), (318.0, 238.0), (-20.0, 100.0)])
def test_distances_to_silhouette_are_those_of_the_whole_image(centre: tuple[float, float]) -> None:
    v, u = np.mgrid[:240, :320]
    silhouette = (np.hypot(u - centre[0], v - centre[1]) < 40) & ((u + v) % 31 > 0)
    rng = np.random.default_rng(0)
    for low, high in (([0, 0], [319, 239]), ([100, 90], [180, 150]), ([-5, -5], [30, 20])):
        points = rng.uniform(low, high, (200, 2))
        expected = sampled(signed_distance(silhouette), points)
        np.testing.assert_allclose(distances_to(silhouette, points), expected, atol=1e-4)
    assert len(distances_to(silhouette, np.zeros((0, 2)))) == 0


def test_exact_mask_has_pixel_grid_noise() -> None:
    noise = measure_noise(find_contour(disc(60), CAMERA), disc(60))
    assert noise.sigma == 0.25
    assert noise.length < 8


def test_noise_of_wavy_mask_is_measured() -> None:
    v, u = np.mgrid[:240, :320]
    angle = np.arctan2(v - 119.6, u - 150.3)
    wavy = np.hypot(u - 150.3, v - 119.6) < 60 + 2 * np.sin(12 * angle)
    noise = measure_noise(find_contour(wavy, CAMERA), disc(60))
    assert noise.sigma == pytest.approx(2 / np.sqrt(2), rel=0.15)
    # the correlation of a sine with a period of 31 px is above 0.1 up to 7 px, on both sides
    assert noise.length == pytest.approx(9.5, rel=0.15)


def test_empty_silhouette_gives_large_noise() -> None:
    noise = measure_noise(find_contour(disc(60), CAMERA), np.zeros((240, 320), dtype=np.bool_))
    assert noise.sigma >= 2
