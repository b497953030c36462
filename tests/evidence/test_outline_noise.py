"""Estimation of the noise of a mask's outline, and bilinear sampling of images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from dvrk_cmaes import Camera
from dvrk_cmaes.evidence.distance_field import distance_within
from dvrk_cmaes.evidence.outline_noise import distances_to, less_margin, measure_noise, sampled, signed_distance
from dvrk_cmaes.evidence.shaft_edges import find_contour

CAMERA = Camera(320, 240, 400, 400, 160, 120)


def disc(radius: float) -> np.ndarray:
    v, u = np.mgrid[:240, :320]
    return np.hypot(u - 150.3, v - 119.6) < radius


@pytest.mark.parametrize("count", [0, 1, 511, 512, 513, 40000])
def test_bilinear_sampling_of_any_number_of_points(count: int) -> None:
    v, u = np.mgrid[:240, :320]
    image = (2 * u + 3 * v).astype(np.float32)
    points = np.random.default_rng(0).uniform([0, 0], [319, 239], (count, 2))
    np.testing.assert_allclose(sampled(image, points), points @ [2, 3], atol=0.2)


def test_signed_distance_of_disc() -> None:
    distance = signed_distance(disc(60))
    v, u = np.mgrid[:240, :320]
    np.testing.assert_allclose(distance, np.hypot(u - 150.3, v - 119.6) - 60, atol=1.0)


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


@pytest.mark.parametrize("away", [0.0, 6.0, 20.0])
def test_distances_are_exact_however_far_from_the_outline_the_pixels_are(away: float) -> None:
    silhouette, middle = disc(60), np.array([150.3, 119.6])
    points = find_contour(silhouette, CAMERA).pixels[::8]
    points = np.concatenate([middle + (points - middle) * (1 + sign * away / 60) for sign in (-1, 1)])
    expected = sampled(signed_distance(silhouette), points)
    np.testing.assert_allclose(distances_to(silhouette, points), expected, atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_distances_to_ragged_silhouettes_are_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.normal(size=(90, 120)), (0, 0), 1.0 + seed)
    silhouette = noise > np.quantile(noise, [0.2, 0.5, 0.8, 0.98][seed])
    points = rng.uniform([-3, -3], [123, 93], (700, 2))
    expected = sampled(signed_distance(silhouette), points)
    np.testing.assert_allclose(distances_to(silhouette, points), expected, atol=1e-4)


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


def test_single_lump_hardly_changes_the_noise() -> None:
    v, u = np.mgrid[:240, :320]
    lump = disc(60) | (np.hypot(u - 210, v - 119.6) < 15)
    assert measure_noise(find_contour(lump, CAMERA), disc(60)).sigma < 0.5


def test_empty_silhouette_gives_large_noise() -> None:
    noise = measure_noise(find_contour(disc(60), CAMERA), np.zeros((240, 320), dtype=np.bool_))
    assert noise.sigma >= 2


def test_distances_within_mask_are_exact() -> None:
    mask = disc(100) & ~disc(5)
    squared = np.rint(distance_transform_edt(mask) ** 2).astype(np.float32)
    np.testing.assert_array_equal(distance_within(mask), np.sqrt(squared))


@pytest.mark.parametrize("margin", [0.3, -0.4, 0.0, 0.99, -0.99, 1.5])
def test_mask_less_margin_follows_from_its_distances(margin: float) -> None:
    rng = np.random.default_rng(3)
    mask = (cv2.ellipse(np.zeros((60, 80), np.uint8), (30, 20), (25, 9), 30.0, 0, 360, 1, -1) > 0) ^ (
        rng.random((60, 80)) < 0.02
    )
    expected = np.clip(0.5 - margin - signed_distance(mask), 0, 1).astype(np.float32)
    np.testing.assert_array_equal(less_margin(mask, margin), expected)
