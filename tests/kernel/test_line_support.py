"""Support of lines by the points of a contour."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes import _kernel

SIGMA, FACING = 1.2, 0.9


def test_support_is_the_sum_of_normal_weights_of_points_that_face_as_the_line() -> None:
    rng = np.random.default_rng(0)
    points, angles = rng.uniform(0, 40, (300, 2)), rng.uniform(-np.pi, np.pi, (2, 300))
    normals, sides = (np.column_stack([np.cos(of), np.sin(of)]) for of in angles)
    lines = np.column_stack([sides, -(sides * points).sum(axis=1)])
    support, middle = _kernel.line_support(points, normals, lines, SIGMA, FACING)
    weights = np.exp(-0.5 * ((points @ lines[:, :2].T + lines[:, 2]) / SIGMA) ** 2)
    weights[normals @ lines[:, :2].T < FACING] = 0.0
    assert np.count_nonzero(support) > 250
    np.testing.assert_allclose(support, weights.sum(axis=0), rtol=1e-13, atol=1e-16)
    expected = (weights.T @ points) / np.maximum(weights.sum(axis=0), 1e-9)[:, None]
    np.testing.assert_allclose(middle, expected, rtol=1e-12, atol=1e-9)


def test_line_without_points_has_no_support() -> None:
    far = np.array([[1.0, 0.0, -1e6]])
    support, middle = _kernel.line_support(np.ones((5, 2)), np.tile([1.0, 0.0], (5, 1)), far, SIGMA, FACING)
    np.testing.assert_array_equal(support, [0.0])
    np.testing.assert_array_equal(middle, [[0.0, 0.0]])
