"""Least-squares solution of one calibration from many frames: exactness, robustness and covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import NAMES, PRIOR, SEEN, World, make_world
from scipy.stats import chi2

from dvrk_cmaes.calibration.model import Calibration
from dvrk_cmaes.calibration.solve import FrameFits, Solution, frame_covariances, leave_one_out, marginalise, solve
from dvrk_cmaes.geometry import change_between, moved, rotation_angle


def a_start(world: World) -> Calibration:
    """Give a start 5 mm and 5 deg from the truth, with zero offsets."""
    off = np.array([3e-3, -3e-3, 3e-3, 0.05, -0.05, 0.05])
    return Calibration(moved(world.truth.camera_from_base, off), np.zeros(5))


def solved(world: World, fits: FrameFits) -> Solution:
    return solve(world.model, fits, a_start(world), PRIOR)


def error(world: World, found: Calibration) -> tuple[float, float]:
    """Give the error of the base: (deg, mm)."""
    true = world.truth.camera_from_base
    return (
        float(np.degrees(rotation_angle(true, found.camera_from_base))),
        float(1e3 * np.linalg.norm(true[:3, 3] - found.camera_from_base[:3, 3])),
    )


def test_exact_data_give_exact_base_and_offsets() -> None:
    world = make_world(noise=0)
    found = solve(world.model, world.fits(np.random.default_rng(0), 1e-4), a_start(world), 1e-9 * PRIOR)
    assert error(world, found.calibration) == pytest.approx((0, 0), abs=2e-3)
    np.testing.assert_allclose(found.calibration.offsets, world.truth.offsets, atol=2e-5)


def test_errors_agree_with_covariance() -> None:
    squared = []
    for seed in range(60):
        rng = np.random.default_rng(1000 + seed)
        offsets = np.diag(PRIOR)[6:] ** -0.5 * rng.standard_normal(5)
        world = make_world(10, seed, offsets=offsets)
        found = solved(world, world.fits(rng))
        off = change_between(found.calibration.camera_from_base, world.truth.camera_from_base)
        squared.append(off @ np.linalg.solve(found.covariance[:6, :6], off))
    held = np.mean(np.array(squared) < chi2.ppf(0.95, 6))
    assert 0.85 <= held <= 1.0
    assert np.median(squared) == pytest.approx(chi2.median(6), rel=0.4)


def test_more_frames_reduce_standard_deviations() -> None:
    spread = [
        np.sqrt(np.diag(solved(world, world.fits(np.random.default_rng(0))).covariance)[:6])
        for world in (make_world(6), make_world(60))
    ]
    assert (spread[1] < 0.6 * spread[0]).all()


def test_errors_that_successive_frames_share_do_not_average_out() -> None:
    world, rng = make_world(80, noise=0), np.random.default_rng(0)
    own, shared = rng.standard_normal((80, 9)), np.repeat(rng.standard_normal((8, 9)), 10, axis=0)
    spreads = []
    for off in (own, shared):
        fits = world.fits(rng)
        off = off * SEEN
        fits = replace(fits, poses=moved(world.poses, off[:, :6]), joints=world.joints + off[:, 6:])
        spreads.append(np.sqrt(np.diag(solved(world, fits).covariance)))
    of_offsets = (spreads[1] / spreads[0])[7:]  # the base follows from readings without errors
    assert of_offsets.mean() > 1.5


def test_third_of_frames_may_be_outliers() -> None:
    world = make_world(12, seed=4)
    right = world.fits(np.random.default_rng(5))
    poses = right.poses.copy()
    wild = np.random.default_rng(6).uniform(-1, 1, (4, 6)) * [0.02, 0.02, 0.02, 1.5, 1.5, 1.5]
    wild[:, :3] += 0.01
    poses[[1, 4, 7, 10]] = moved(poses[[1, 4, 7, 10]], wild)
    good, found = solved(world, right), solve(world.model, replace(right, poses=poses), world.truth, PRIOR)
    apart = change_between(good.calibration.camera_from_base, found.calibration.camera_from_base)
    assert (np.abs(apart) < 2 * np.sqrt(np.diag(found.covariance)[:6])).all()
    assert set(np.flatnonzero(found.weights < 0.05)) == {1, 4, 7, 10}
    assert set(np.flatnonzero(found.misfit > 12 * 9)) == {1, 4, 7, 10}


def test_leave_one_out_agrees_with_solution_of_other_frames() -> None:
    # The frames agree, so the weights do not depend on the frame that is left out.
    world = make_world(8, noise=0)
    fits = world.fits(np.random.default_rng(0), 0.05)
    whole = solved(world, fits)
    for index in (0, 5):
        others = [i for i in range(8) if i != index]
        again = solve(world.model.subset(others), fits.subset(others), whole.calibration, PRIOR)
        short = leave_one_out(whole, index)
        apart = change_between(again.calibration.camera_from_base, short.camera_from_base)
        spread = np.sqrt(np.diag(again.covariance))
        assert (np.abs(apart) < 0.02 * spread[:6]).all()
        assert (np.abs(again.calibration.offsets - short.offsets) < 0.02 * spread[6:]).all()


def test_marginalised_information_is_exact() -> None:
    world = make_world(1, seed=2)
    fits = world.fits(np.random.default_rng(0))
    frame = marginalise(world.model, fits, world.truth)
    expected = world.model.covariance(world.truth)[0]
    np.testing.assert_allclose(frame.information[0] @ (expected + np.diag(SEEN**2)), np.eye(9), atol=1e-6)
    poses, joints = world.model.predict(world.truth)
    off = np.concatenate([change_between(fits.poses, poses), joints - fits.joints], axis=1)[0]
    assert frame.misfit[0] == pytest.approx(off @ np.linalg.solve(expected + np.diag(SEEN**2), off))


def test_frame_without_outline_information_stays_as_predicted() -> None:
    world = make_world(6)
    fits = world.fits(np.random.default_rng(0))
    blind = fits.information.copy()
    blind[2] *= 1e-12
    frames = marginalise(world.model, replace(fits, information=blind), world.truth)
    np.testing.assert_allclose(frames.deviation[2], 0, atol=1e-6)
    np.testing.assert_allclose(frames.covariance[2], world.model.covariance(world.truth)[2], rtol=1e-6, atol=1e-12)
    assert frames.misfit[2] == pytest.approx(0, abs=1e-6)


def test_session_reduces_standard_deviations_of_frames() -> None:
    world = make_world(10)
    fits = world.fits(np.random.default_rng(0))
    known = np.sqrt(np.einsum("nii->ni", frame_covariances(world.model, fits, solved(world, fits))))
    assert (known < SEEN).all()
    fixed = np.sqrt(np.einsum("nii->ni", marginalise(world.model, fits, world.truth).covariance))
    assert (known >= fixed).all()


def test_undetermined_offsets_keep_prior_standard_deviation() -> None:
    world = make_world(8, turning=0.0)
    found = solved(world, world.fits(np.random.default_rng(0)))
    spread = np.sqrt(np.diag(found.covariance))
    roll, insertion = spread[7], spread[6]
    assert np.degrees(roll) > 0.9 * 20
    assert 1e3 * insertion > 0.9 * 0.5
    assert np.isfinite(found.calibration.offsets).all()
    assert abs(np.degrees(found.calibration.offsets[1])) < 20
    assert len(spread) == 8 + len(NAMES)
