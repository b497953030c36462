"""Refinement under correlated outline noise by generalised least squares: its accuracy and its conditions."""

from __future__ import annotations

import cv2
import numpy as np
from helpers.frame_terms import Terms, readings_of, view_of
from helpers.transforms import lookat_pose

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.refine.gauss_newton import Steps, refine
from dvrk_cmaes.pose.terms.contour import CorrelatedContour

CAMERA = Camera(640, 480, 880, 880, 330, 250)
TRUE = Posed(lookat_pose(0.2, 0.3, 1.0, 0.12), np.array([0.4, -0.3, 0.5]))
READ = TRUE.joints + np.array([0.1, -0.1, 0.15])


def noisy_mask(body: Body, seed: int, size: float = 1.0) -> np.ndarray:
    """Give the silhouette with its outline moved by smooth errors: std ``size`` px, correlation length about 20 px."""
    exact = Renderer(body, CAMERA).masks(TRUE.pose[None], TRUE.joints[None])[0]
    waves = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal(exact.shape), (0, 0), 6.0)
    return signed_distance(exact) < size * waves / waves.std()


def terms(body: Body, mask: np.ndarray, read: np.ndarray = READ, ignore: np.ndarray | None = None) -> Terms:
    return Terms([view_of(body, CAMERA, mask, ignore=ignore)], readings_of(body, read))


def refined(at: Terms, start: Posed) -> Posed:
    """Give a pose after steps on the contour with correlated errors."""
    steps = Steps(6, tolerance=0.1, tested="none", largest=6.0)
    return refine(CorrelatedContour(at.views), at.others, start[None], steps)[0].at


def tip_error(body: Body, at: Posed) -> float:
    """Give the root mean square error of the jaw tips, mm."""
    tips, true = (body.instrument.tips(p.joints) @ p.pose[:3, :3].T + p.pose[:3, 3] for p in (at, TRUE))
    return float(1e3 * np.sqrt(((tips - true) ** 2).sum(axis=1).mean()))


def axis_error(pose: np.ndarray) -> float:
    """Give the angle between the shaft's axis and the true one, deg."""
    return float(np.degrees(np.linalg.norm(np.cross(pose[:3, 2], TRUE.pose[:3, 2]))))


def test_modelled_correlation_reduces_errors(bundled_body: Body) -> None:
    rng = np.random.default_rng(5)
    tips, axes = [], []
    for seed in range(8):
        at = terms(bundled_body, noisy_mask(bundled_body, seed))
        off = np.r_[rng.normal(size=6) * [3e-4, 3e-4, 1e-3, 0.03, 0.03, 0.08], 0.1 * rng.normal(size=3)]
        (fit,) = at.refined(at.refined(TRUE.moved(off))[0].at, cauchy=OutlineConfig.last_cauchy)
        both = fit.at, refined(at, fit.at)
        tips.append([tip_error(bundled_body, each) for each in both])
        axes.append([axis_error(each.pose) for each in both])
    before, after = np.sqrt(np.mean(np.square(axes), axis=0))
    assert after < 0.7 * before
    assert after < 1.0
    before, after = np.mean(tips, axis=0)
    assert after < 0.9 * before


def test_outliers_are_rejected(bundled_body: Body) -> None:
    mask = noisy_mask(bundled_body, 1)
    bitten = mask.copy()
    row, column = np.argwhere(mask)[len(np.argwhere(mask)) // 3]
    cv2.circle(blob := np.zeros(mask.shape, dtype=np.uint8), (int(column), int(row)), 14, 1, -1)
    bitten[blob > 0] = False
    whole, less = (refined(terms(bundled_body, each), TRUE) for each in (mask, bitten))
    assert tip_error(bundled_body, less) < tip_error(bundled_body, whole) + 0.15


def test_joints_stay_near_their_limits(bundled_body: Body) -> None:
    mask = noisy_mask(bundled_body, 0)
    readings = readings_of(bundled_body, TRUE.joints)
    readings.low[2], readings.high[2] = 0.0, 0.1  # the jaw is open by 0.5
    at = Terms([view_of(bundled_body, CAMERA, mask)], readings)
    assert refined(at, TRUE).joints[2] <= 0.1 + np.deg2rad(3.0) + 1e-12


def test_hidden_joints_without_readings_stay_as_they_are(bundled_body: Body) -> None:
    wrist = CAMERA.project(TRUE.pose[None, :3, 3])[0]
    hidden = np.linalg.norm(np.indices((CAMERA.height, CAMERA.width))[::-1].T - wrist, axis=2).T < 200
    at = terms(bundled_body, noisy_mask(bundled_body, 0), np.full(3, np.nan), hidden)
    there = refined(at, TRUE.moved(np.array([5e-4, 0, 0, 0, 0.01, 0, 0, 0, 0])))
    np.testing.assert_allclose(there.joints, TRUE.joints, atol=1e-6)
    assert np.isfinite(there.pose).all()
