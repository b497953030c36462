"""Refinement on several views: one noise scale for all, two views to the truth, and rotations of the rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.frame_terms import Terms, cost_of, readings_of, view_at
from helpers.transforms import exp_rotation, lookat_pose, moved, rotation_angle, transform

from dvrk_cmaes import Body, Camera
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.rig_rotation import Rotation, rotations_of_views
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.views import FrameView

CAMERA = Camera(320, 240, 480, 480, 160, 120)
RIGHT_FROM_LEFT = transform(exp_rotation([0.01, -0.02, 0.01]), [-0.005, 0.0, 0.0003])
TRUE = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.5]))
START = TRUE.moved(np.array([3e-4, -3e-4, 5e-4, 0.01, -0.01, 0.05, 0.05, 0.05, 0.05]))


def views_of(body: Body, camera: Camera = CAMERA, believed: np.ndarray = RIGHT_FROM_LEFT) -> list[FrameView]:
    """Give two views of the true pose, of which the second is believed to be at ``believed``."""
    right = view_at(body, camera, TRUE, RIGHT_FROM_LEFT)
    return [view_at(body, camera, TRUE), replace(right, view_from_camera=believed)]


def terms(body: Body, views: list[FrameView]) -> Terms:
    return Terms(views, readings_of(body, TRUE.joints + 0.05))


def rotation(body: Body, views: list[FrameView], readings: Readings | None = None) -> Rotation:
    """Give the rotation of the second view at the pose that fits both."""
    both = terms(body, views) if readings is None else Terms(views, readings)
    (fit,) = both.refined(TRUE)
    ((turn, covariance),) = rotations_of_views(both.views, both.others, fit.at, [fit.information / 2] * 2)
    return turn, covariance


def test_two_views_converge_to_the_truth(bundled_body: Body) -> None:
    (fit,) = terms(bundled_body, views_of(bundled_body)).refined(START)
    assert np.linalg.norm(fit.at.pose[:3, 3] - TRUE.pose[:3, 3]) < 1.5e-4
    assert rotation_angle(fit.at.pose, TRUE.pose) < np.deg2rad(0.8)


def test_views_count_by_their_independent_measurements(bundled_body: Body) -> None:
    views = [SizedView(view, blur=1.2) for view in views_of(bundled_body)]
    off = TRUE.moved(np.array([2e-4, 0, 0, 0, 0.01, 0, 0, 0, 0]))[None]
    config = terms(bundled_body, views_of(bundled_body)).config
    alone = [cost_of(Coverage([view], config, noise=1.0), off)[0] for view in views]
    both = Coverage(views, config, correlations=[8.0, 16.0], noise=1.0)
    assert cost_of(both, off)[0] == pytest.approx(alone[0] + alone[1] / 2)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_small_rotation_of_the_rig_is_found(bundled_body: Body, axis: int) -> None:
    turn = np.zeros(3)
    turn[axis] = np.deg2rad(0.1)
    # The right camera is believed to be turned by -turn against where it is.
    views = views_of(bundled_body, believed=moved(RIGHT_FROM_LEFT, np.r_[np.zeros(3), -turn]))
    fitted, covariance = rotation(bundled_body, views)
    np.testing.assert_allclose(fitted, turn, atol=np.deg2rad(0.03))
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_large_rotation_of_the_rig_is_found(bundled_body: Body) -> None:
    turn = np.deg2rad([0.5, -0.4, 0.3])
    views = views_of(bundled_body, believed=moved(RIGHT_FROM_LEFT, np.r_[np.zeros(3), -turn]))
    np.testing.assert_allclose(rotation(bundled_body, views)[0], turn, atol=np.deg2rad(0.08))


def test_jaw_outside_of_both_images_does_not_hinder(bundled_body: Body) -> None:
    # Only the shaft is in the images, whose contours tell nothing of the joints.
    views = views_of(bundled_body, Camera(320, 240, 480, 480, 310, -50))
    unknown = Readings(np.full(3, np.nan), np.ones(3), np.full(3, -np.inf), np.full(3, np.inf))
    assert not Terms(views, unknown).assessed(TRUE).information[8].any()
    turn, covariance = rotation(bundled_body, views, unknown)
    assert np.isfinite(turn).all()
    assert np.isfinite(covariance).all()
