"""Refinement on the coverage: convergence from nearby starts, and finite results from distant ones."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.frame_terms import Terms, readings_of, view_at
from helpers.transforms import lookat_pose, rotation_angle

from dvrk_cmaes import Body, Camera
from dvrk_cmaes.geometry import Posed

CAMERA = Camera(640, 480, 880, 880, 330, 250)
TRUE = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.5]))
NEAR = np.array([3e-4, -3e-4, 5e-4, 0.01, -0.01, 0.05, 0.05, 0.05, 0.05])


def terms(
    body: Body, read: np.ndarray = TRUE.joints, shrink: int = 1, ignore: np.ndarray | None = None, **settings: float
) -> Terms:
    return Terms([view_at(body, CAMERA, TRUE, ignore=ignore)], readings_of(body, read), shrink, **settings)


@pytest.mark.parametrize("shrink", [1, 2, 4])
def test_nearby_start_converges_to_truth(bundled_body: Body, shrink: int) -> None:
    (fit,) = terms(bundled_body, shrink=shrink).refined(TRUE.moved(NEAR))
    # The tolerance grows with the pixel size.
    assert np.linalg.norm(fit.at.pose[:3, 3] - TRUE.pose[:3, 3]) < 1.5e-4 * shrink
    assert rotation_angle(fit.at.pose, TRUE.pose) < np.deg2rad(0.8) * shrink
    np.testing.assert_allclose(fit.at.joints, TRUE.joints, atol=np.deg2rad(0.8) * shrink)


def test_batch_agrees_with_single_refinements(bundled_body: Body) -> None:
    at = terms(bundled_body, shrink=4)
    starts = [TRUE.moved(np.array([0, 0, 0, 0.01 * i, 0, 0.05 * i, 0, 0, 0])) for i in range(4)]
    for start, fit in zip(starts, at.refined(*starts), strict=True):
        assert at.refined(start)[0].score == pytest.approx(fit.score, abs=0.5)


def test_silhouette_outside_window_gives_finite_score(bundled_body: Body) -> None:
    away = Posed(TRUE.pose.copy(), TRUE.joints)
    away.pose[:3, 3] += [0.5, 0.3, 0.0]
    lost, fit = terms(bundled_body).refined(away, TRUE)
    assert np.isfinite(lost.score)
    assert fit.score < lost.score
