"""Refinement on several views: one view as the plain refiner, two views to the truth, and rotations of the rig."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.geometry import exp_rotation, moved, rotation_angle, transform
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.joint_refiner import JointRefiner
from dvrk_cmaes.pose.refine.outline import OutlineRefiner
from dvrk_cmaes.pose.refine.rig_rotation import rig_rotations
from dvrk_cmaes.pose.search.starts import lookat_pose
from dvrk_cmaes.pose.views import without_readings
from dvrk_cmaes.silhouette import Body, Renderer

CAMERA = Camera(320, 240, 480, 480, 160, 120)
RIGHT_FROM_LEFT = transform(exp_rotation([0.01, -0.02, 0.01]), [-0.005, 0.0, 0.0003])
TRUTH = lookat_pose(0.5, 1.0, 0.7, 0.11)
JOINTS = np.array([0.4, -0.3, 0.5])
START = moved(TRUTH, np.array([3e-4, -3e-4, 5e-4, 0.01, -0.01, 0.05]))


def refiner(body: Body, view_from_camera: np.ndarray, *, first: bool) -> OutlineRefiner:
    """Give the refiner of a view that shows the true pose; the first view's has the readings."""
    renderer = Renderer(body, CAMERA)
    mask = renderer.masks((view_from_camera @ TRUTH)[None], JOINTS[None])[0]
    low, high = body.instrument.limits.T
    readings = Readings(JOINTS + 0.05, np.deg2rad([10, 10, 15]), low, high)
    evidence = gather_evidence(mask, CAMERA, body.instrument)
    return OutlineRefiner(renderer, evidence, readings if first else without_readings(readings), OutlineConfig())


def joint(body: Body, *, believed: np.ndarray = RIGHT_FROM_LEFT) -> JointRefiner:
    """Give the refiner of two views, of which the second is believed to be at ``believed``."""
    views = [(refiner(body, np.eye(4), first=True), np.eye(4)), (refiner(body, RIGHT_FROM_LEFT, first=False), believed)]
    return JointRefiner(views, OutlineConfig())


def test_one_view_is_refined_to_the_optimum_of_its_refiner(bundled_body: Body) -> None:
    alone = refiner(bundled_body, np.eye(4), first=True)
    together = JointRefiner([(alone, np.eye(4))], OutlineConfig())
    expected, found = (each.refine_all(START[None], JOINTS[None] + 0.05)[0] for each in (alone, together))
    assert np.linalg.norm(found.camera_from_root[:3, 3] - expected.camera_from_root[:3, 3]) < 5e-5
    assert rotation_angle(found.camera_from_root, expected.camera_from_root) < np.deg2rad(0.2)
    np.testing.assert_allclose(found.joints, expected.joints, atol=np.deg2rad(0.5))
    at_one_pose = [each.assess(found.camera_from_root, found.joints) for each in (alone, together)]
    np.testing.assert_allclose(at_one_pose[0].information, at_one_pose[1].information, rtol=1e-6)


def test_two_views_converge_to_the_truth(bundled_body: Body) -> None:
    fit = joint(bundled_body).refine_all(START[None], JOINTS[None] + 0.05)[0]
    assert np.linalg.norm(fit.camera_from_root[:3, 3] - TRUTH[:3, 3]) < 1.5e-4
    assert rotation_angle(fit.camera_from_root, TRUTH) < np.deg2rad(0.8)


def test_score_is_lowest_at_the_truth(bundled_body: Body) -> None:
    both = joint(bundled_body)
    best = both.assess(TRUTH, JOINTS)
    for axis in range(6):
        change = np.zeros(6)
        change[axis] = 1e-3 if axis < 3 else 0.05
        assert both.assess(moved(TRUTH, change), JOINTS).outline_score > best.outline_score


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_small_rotation_of_the_rig_is_found(bundled_body: Body, axis: int) -> None:
    turn = np.zeros(3)
    turn[axis] = np.deg2rad(0.1)
    # The right camera is believed to be turned by -turn against where it is.
    both = joint(bundled_body, believed=moved(RIGHT_FROM_LEFT, np.r_[np.zeros(3), -turn]))
    fit = both.refine_all(TRUTH[None], JOINTS[None])[0]
    ((found, covariance),) = rig_rotations(both, fit, [fit.information / 2, fit.information / 2])
    np.testing.assert_allclose(found, turn, atol=np.deg2rad(0.03))
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_views_that_agree_need_no_rotation(bundled_body: Body) -> None:
    both = joint(bundled_body)
    fit = both.refine_all(TRUTH[None], JOINTS[None])[0]
    ((found, _),) = rig_rotations(both, fit, [fit.information / 2, fit.information / 2])
    assert np.degrees(np.abs(found)).max() < 0.03


def test_jaw_outside_of_both_images_does_not_hinder(bundled_body: Body) -> None:
    # Only the shaft is in the images, whose contours tell nothing of the joints.
    shaft_only = Camera(320, 240, 480, 480, 310, -50)
    views = []
    for place in (np.eye(4), RIGHT_FROM_LEFT):
        renderer = Renderer(bundled_body, shaft_only)
        mask = renderer.masks((place @ TRUTH)[None], JOINTS[None])[0]
        evidence = gather_evidence(mask, shaft_only, bundled_body.instrument)
        unknown = without_readings(Readings(JOINTS, np.ones(3), -np.ones(3), np.ones(3)))
        views.append((OutlineRefiner(renderer, evidence, unknown, OutlineConfig()), place))
    both = JointRefiner(views, OutlineConfig())
    fit = both.assess(TRUTH, JOINTS)
    assert not fit.information[8].any()
    ((found, covariance),) = rig_rotations(both, fit, [fit.information / 2, fit.information / 2])
    assert np.isfinite(found).all()
    assert np.isfinite(covariance).all()
