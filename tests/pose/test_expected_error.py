"""Expected errors of tips and shaft: agreement with samples of the covariance."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.transforms import apply, lookat_pose, moved
from scipy.special import gammaincinv

from dvrk_cmaes import Body, Camera
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.expected_error import expected_error, largest_distance, locate_tips

POSE, JOINTS = lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.8])
SPREAD = np.array([3e-4, 2e-4, 8e-4, 0.006, 0.01, 0.02, 0.03, 0.02, 0.04])


def test_errors_are_those_of_samples(bundled_body: Body) -> None:
    instrument, rng = bundled_body.instrument, np.random.default_rng(0)
    turn = np.linalg.qr(rng.standard_normal((9, 9)))[0] * 0.2 + np.eye(9)
    root = np.diag(SPREAD) @ turn
    stated = expected_error(instrument, Posed(POSE, JOINTS), root @ root.T)
    changes = rng.standard_normal((20000, 9)) @ root.T
    poses, joints = moved(POSE, changes[:, :6]), JOINTS + changes[:, 6:]
    off = 1e3 * (apply(poses, instrument.tips(joints)) - apply(POSE, instrument.tips(JOINTS)))
    for k, name in enumerate(("jaw_1", "jaw_2")):
        assert stated.tip_mm[name] == pytest.approx(np.sqrt((off[:, k] ** 2).sum(axis=1).mean()), rel=0.03)
        np.testing.assert_allclose(stated.tip_axes_mm[name], off[:, k].std(axis=0), rtol=0.04)
    within = (np.linalg.norm(off, axis=2) < stated.tip_90_mm).mean(axis=0)
    assert within.min() == pytest.approx(0.9, abs=0.02)
    angles = np.degrees(np.arccos(np.clip(poses[:, :3, 2] @ POSE[:3, 2], -1, 1)))
    assert stated.shaft_deg == pytest.approx(np.sqrt((angles**2).mean()), rel=0.03)


@pytest.mark.parametrize("axes", [(1, 1, 1), (1, 0, 0), (3, 1, 0.5)])
def test_distance_holds_nine_tenths(axes: tuple[float, ...]) -> None:
    samples = np.random.default_rng(1).standard_normal((20000, 3)) * axes
    distance = largest_distance(np.diag(np.square(axes, dtype=float)))
    assert (np.linalg.norm(samples, axis=1) < distance).mean() == pytest.approx(0.9, abs=0.02)


def test_tips_are_located_in_camera_and_image(bundled_body: Body) -> None:
    camera = Camera(640, 480, 880, 880, 330, 250)
    points, pixels = locate_tips(bundled_body.instrument, camera, Posed(POSE, JOINTS))
    np.testing.assert_allclose(points, apply(POSE, bundled_body.instrument.tips(JOINTS)))
    np.testing.assert_allclose(pixels, camera.project(np.array(points)))
    behind = moved(POSE, np.array([0, 0, -0.3, 0, 0, 0]))
    assert locate_tips(bundled_body.instrument, camera, Posed(behind, JOINTS))[1] == ()


@pytest.mark.parametrize("axes", [(1, 0, 0), (1, 0.3, 0.1), (2, 1, 1), (1, 1, 1)])
def test_distance_is_quantile_of_gamma_distribution(axes: tuple[float, ...]) -> None:
    squares = np.square(axes, dtype=float)
    mean, variance = squares.sum(), 2 * (squares**2).sum()
    expected = np.sqrt(gammaincinv(mean**2 / variance, 0.9) * variance / mean)
    assert largest_distance(np.diag(squares)) == pytest.approx(expected, rel=1e-12)
