"""Refinement on the outline: convergence from nearby starts, and finite results from distant ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.geometry import moved, rotation_angle
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.outline import OutlineRefiner
from dvrk_cmaes.silhouette import Body, Renderer

CAMERA = Camera(640, 480, 880, 880, 330, 250)
JOINTS = np.array([0.4, -0.3, 0.5])
SPREAD = np.deg2rad([10, 10, 15])


def pose() -> np.ndarray:
    from dvrk_cmaes.pose.search.starts import lookat_pose

    return lookat_pose(0.5, 1.0, 0.7, 0.11)


def refiner(
    body: Body, readings: np.ndarray, shrink: int = 1, ignore: np.ndarray | None = None, **settings: float
) -> OutlineRefiner:
    renderer = Renderer(body, CAMERA)
    mask = renderer.coverage(pose()[None], JOINTS[None])[0] > 0.5
    evidence = gather_evidence(mask, CAMERA, body.instrument, ignore=ignore)
    limits = body.instrument.limits.T
    known = Readings(readings, SPREAD, limits[0], limits[1])
    return OutlineRefiner(renderer, evidence, known, OutlineConfig(**settings), shrink=shrink)


@pytest.mark.parametrize("shrink", [1, 2, 4])
def test_nearby_start_converges_to_truth(bundled_body: Body, shrink: int) -> None:
    start = moved(pose(), np.array([3e-4, -3e-4, 5e-4, 0.01, -0.01, 0.05]))
    fit = refiner(bundled_body, JOINTS, shrink).refine_all(start[None], JOINTS[None] + 0.05)[0]
    # The tolerance grows with the pixel size.
    assert np.linalg.norm(fit.camera_from_root[:3, 3] - pose()[:3, 3]) < 1.5e-4 * shrink
    assert rotation_angle(fit.camera_from_root, pose()) < np.deg2rad(0.8) * shrink
    np.testing.assert_allclose(fit.joints, JOINTS, atol=np.deg2rad(0.8) * shrink)


def test_batch_agrees_with_single_refinements(bundled_body: Body) -> None:
    at = refiner(bundled_body, JOINTS, 4)
    starts = np.stack([moved(pose(), np.array([0, 0, 0, 0.01 * i, 0, 0.05 * i])) for i in range(4)])
    together = at.refine_all(starts, np.tile(JOINTS, (4, 1)))
    for start, fit in zip(starts, together, strict=True):
        alone = at.refine_all(start[None], JOINTS[None])[0]
        assert alone.score == pytest.approx(fit.score, abs=0.5)


@pytest.mark.parametrize("shrink", [1, 2])
def test_border_of_ignored_pixels_is_no_edge(bundled_body: Body, shrink: int) -> None:
    ignore = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    wrist = CAMERA.project(pose()[None, :3, 3])[0].astype(int)
    ignore[wrist[1] - 25 : wrist[1] + 25, wrist[0] - 25 : wrist[0] + 25] = True  # across the instrument
    whole, hidden = (
        refiner(bundled_body, JOINTS, shrink, ignore=one).assess(pose(), JOINTS).residual for one in (None, ignore)
    )
    assert hidden <= whole


def test_weight_of_readings_follows_correlation(bundled_body: Body) -> None:
    off = JOINTS + np.array([0.2, 0, 0])
    weak, strong = (
        refiner(bundled_body, off, 4, correlation=length).refine_all(pose()[None], JOINTS[None])[0].joints[0]
        for length in (1.0, 1e5)
    )
    assert abs(weak - JOINTS[0]) < 0.25 * abs(strong - JOINTS[0])


def test_silhouette_outside_window_gives_finite_score(bundled_body: Body) -> None:
    away = moved(pose(), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    away[:3, 3] += [0.5, 0.3, 0.0]
    fit = refiner(bundled_body, JOINTS).refine_all(np.stack([away, pose()]), np.tile(JOINTS, (2, 1)))
    assert np.isfinite(fit[0].score)
    assert fit[1].score < fit[0].score


@pytest.mark.parametrize(("unknown", "step"), [(0, 2e-3), (1, 0.3), (2, 0.3)])
def test_slope_about_camera_is_gradient_of_residual(bundled_body: Body, unknown: int, step: float) -> None:
    off = moved(pose(), np.array([3e-4, -2e-4, 1e-3, 0, 0, 0]))
    at = refiner(bundled_body, JOINTS, cauchy=10.0)
    at.set_noise_at(off, JOINTS)
    information, slope = at.terms_with_camera(off, JOINTS)
    np.testing.assert_allclose(information, information.T)
    mask = Renderer(bundled_body, CAMERA).coverage(pose()[None], JOINTS[None])[0] > 0.5
    evidence = gather_evidence(mask, CAMERA, bundled_body.instrument)
    limits = bundled_body.instrument.limits.T

    def residual(change: np.ndarray, moving: np.ndarray) -> float:
        camera = CAMERA.changed(float(np.exp(change[0])), (float(change[1]), float(change[2])))
        known = Readings(JOINTS, SPREAD, limits[0], limits[1])
        seen = replace(evidence, camera=camera)
        there = OutlineRefiner(Renderer(bundled_body, camera), seen, known, OutlineConfig(cauchy=10.0))
        return there.assess(moved(off, moving), JOINTS).residual

    still, along = np.zeros(3), np.array([0, 0, 5e-5, 0, 0, 0])
    changed = np.eye(3)[unknown] * step
    about_camera = (residual(changed, 0 * along) - residual(-changed, 0 * along)) / (2 * step)
    about_pose = (residual(still, along) - residual(still, -along)) / (2 * along[2])
    # both have the factor from coverage to standard deviations
    assert slope[9 + unknown] / about_camera == pytest.approx(slope[2] / about_pose, rel=0.2)
