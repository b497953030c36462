"""Refinement under correlated outline noise by generalised least squares: its accuracy and its conditions."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.frame_terms import Terms, readings_of, view_of
from helpers.transforms import lookat_pose

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise, signed_distance
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.refine.gauss_newton import Steps, refine
from dvrk_cmaes.pose.terms.contour import CorrelatedContour, has_correlated_noise
from dvrk_cmaes.pose.terms.sized_view import SizedView

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


def test_correlated_noise_is_recognised(bundled_body: Body) -> None:
    exact = Renderer(bundled_body, CAMERA).masks(TRUE.pose[None], TRUE.joints[None])[0]
    for size, expected in ((1.0, True), (0.0, False)):
        evidence = gather_evidence(noisy_mask(bundled_body, 1, size), CAMERA, bundled_body.instrument)
        assert has_correlated_noise(measure_noise(evidence.contour, exact)) == expected
    assert not has_correlated_noise(OutlineNoise(sigma=1.5, length=35.0))


def test_outliers_are_rejected(bundled_body: Body) -> None:
    mask = noisy_mask(bundled_body, 1)
    bitten = mask.copy()
    row, column = np.argwhere(mask)[len(np.argwhere(mask)) // 3]
    cv2.circle(blob := np.zeros(mask.shape, dtype=np.uint8), (int(column), int(row)), 14, 1, -1)
    bitten[blob > 0] = False
    whole, less = (refined(terms(bundled_body, each), TRUE) for each in (mask, bitten))
    assert tip_error(bundled_body, less) < tip_error(bundled_body, whole) + 0.15


def test_pose_far_from_mask_is_unchanged(bundled_body: Body) -> None:
    away = TRUE.pose.copy()
    away[:3, 3] += [0.5, 0.3, 0.0]
    at = refined(terms(bundled_body, noisy_mask(bundled_body, 0)), Posed(away, TRUE.joints))
    np.testing.assert_array_equal(at.pose, away)
    np.testing.assert_array_equal(at.joints, TRUE.joints)


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


def test_steps_are_those_of_the_whole_covariance(bundled_body: Body) -> None:
    """Correlations that are left out, between points farther apart than 40 px, hardly change a step."""
    view = terms(bundled_body, noisy_mask(bundled_body, 3)).views[0]
    at = TRUE.moved(np.array([2e-4, -1e-4, 3e-4, 0.01, 0.0, 0.02, 0.02, -0.03, 0.05]))
    (drawn,) = CorrelatedContour([view]).draw(at[None])
    information, slope, cost = _whole(view, at)
    deviations = np.sqrt(np.diag(np.linalg.inv(information)))
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(drawn.information))), deviations, rtol=1e-4)
    steps = np.linalg.solve(drawn.information, drawn.slope), np.linalg.solve(information, slope)
    assert (np.abs(steps[0] - steps[1]) < 1e-3 * deviations).all()
    assert drawn.cost == pytest.approx(cost, rel=1e-4)


def _whole(view: SizedView, at: Posed) -> tuple[np.ndarray, np.ndarray, float]:
    """Give information, slope and sum of squares with the covariance of all points."""
    (outline,) = view.outlines(at[None])
    (jacobian,) = view.jacobians([outline], at[None])
    lengths = np.linalg.norm(outline.normals, axis=1)
    errors = []
    for (u, v), normal in zip(outline.pixels, outline.normals, strict=True):
        flat = abs(normal[0]) < abs(normal[1])
        line = view.mask[:, round(u)] if flat else view.mask[round(v)]
        along, outwards = (v, np.sign(normal[1])) if flat else (u, np.sign(normal[0]))
        edges = np.flatnonzero(np.diff(line.astype(int)) == -outwards)
        edges = edges[np.abs(edges - np.floor(along)) <= 8]
        off = edges + 0.5 - along
        errors.append(outwards * off[np.abs(off).argmin()] if len(off) else np.nan)
    error = np.array(errors) / lengths
    sigma = max(NORMAL_MEDIAN * float(np.nanmedian(np.abs(error))), 0.5)
    used = np.abs(error) < 2.5 * sigma
    error, pixels, lengths, jacobian = error[used], outline.pixels[used], lengths[used], jacobian[used]
    jacobian = jacobian / lengths[:, None]
    variance = float(np.mean(error**2)) - 1 / 24
    apart = np.linalg.norm(pixels[:, None] - pixels, axis=2)
    covariance = 0.95 * variance * np.exp(-np.pi * (apart / 21) ** 2)
    covariance += np.diag(0.05 * 21 * variance + 1 / 12 / lengths**2)
    solved = np.linalg.solve(covariance, np.c_[jacobian, error]) / 2
    return jacobian.T @ solved[:, :-1], -jacobian.T @ solved[:, -1], float(error @ solved[:, -1])
