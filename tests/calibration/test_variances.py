"""Variance components of the readings' errors, estimated from a session, and their robustness to single slips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import PRIOR, World, make_world

from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.solve import FrameFits, solution_at, solve
from dvrk_cmaes.calibration.variances import estimate_variances
from dvrk_cmaes.config import SessionConfig

CONFIG = SessionConfig()


def learnt(world: World, fits: FrameFits, turns: int = 6) -> SessionModel:
    """Alternate between solving and estimating the variances, as the calibration of a session does."""
    model, calibration = world.model, world.truth
    for _ in range(turns):
        solution = solve(model, fits, calibration, PRIOR)
        calibration = solution.calibration
        model = estimate_variances(model, fits, solution, CONFIG)
    return model


def strayed(world: World, joint: int, degrees: np.ndarray) -> World:
    """Add errors, one a frame, deg, to a joint's readings; the true poses stay."""
    joints = world.model.joints.copy()
    joints[:, joint] += np.deg2rad(degrees)
    return replace(world, model=replace(world.model, outer=world.model.outer, joints=joints))


def test_standard_deviations_of_session_are_found() -> None:
    rng = np.random.default_rng(0)
    world = make_world(80, noise=0)
    for joint, degrees in ((0, 0.5), (1, 3.0)):
        off = degrees * rng.standard_normal(80)
        model = learnt(strayed(world, joint, off), world.fits(rng, 0.3))
        assert np.degrees(model.deviations.joints[joint]) == pytest.approx(off.std(), rel=0.2, abs=0.3)


def test_frames_that_tell_nothing_change_no_standard_deviation() -> None:
    world = make_world(40)
    fits = replace(world.fits(np.random.default_rng(0), 1e4), at=world.model.predict(world.truth))
    model = estimate_variances(world.model, fits, solution_at(world.model, fits, world.truth, PRIOR), CONFIG)
    np.testing.assert_allclose(model.deviations.joints, world.model.deviations.joints, rtol=1e-3)
    np.testing.assert_allclose(model.deviations.outer, world.model.deviations.outer, rtol=1e-3)


def test_few_frames_change_standard_deviations_little() -> None:
    world = make_world(3, noise=0)
    model = learnt(world, world.fits(np.random.default_rng(0), 0.1))
    ratio = model.deviations.joints / world.model.deviations.joints
    assert (ratio > 0.3).all()
    assert (ratio < 1).all()


def test_outer_standard_deviations_never_shrink_below_configured() -> None:
    world = make_world(40, noise=0)
    model = learnt(world, world.fits(np.random.default_rng(0), 0.1))
    assert (model.deviations.outer[:3] >= world.model.deviations.outer[:3]).all()


def test_slack_shrinks_without_residuals() -> None:
    slack = make_world(1).model.deviations.slack
    world = make_world(40, noise=0)
    assert (learnt(world, world.fits(np.random.default_rng(0), 0.02), 20).deviations.slack < 0.6 * slack).all()
    far = make_world(40, noise=8)
    assert (learnt(far, far.fits(np.random.default_rng(0))).deviations.slack <= slack * (1 + 1e-9)).all()


def test_growth_of_standard_deviations_is_limited() -> None:
    rng = np.random.default_rng(1)
    world = strayed(make_world(40, noise=0), 0, 40 * rng.standard_normal(40))
    model = learnt(world, world.fits(rng, 0.3))
    assert model.deviations.joints[0] <= CONFIG.cable_growth * np.deg2rad(CONFIG.wrist_deg) * (1 + 1e-9)


def test_slip_of_one_joint_changes_its_frame_only() -> None:
    world = make_world(12, seed=2)
    fits = world.fits(np.random.default_rng(0))
    slipped = strayed(world, 0, np.array([0, 0, 0, 40.0] + [0] * 8))
    usual, model = learnt(world, fits), learnt(slipped, fits)
    assert model.deviations.joints[0] < 1.3 * usual.deviations.joints[0]
    assert model.inflation[3, 1] == pytest.approx(2.0)
    assert (np.delete(model.inflation[:, 1], 3) < 1.5).all()
    before = solve(usual, fits, world.truth, PRIOR)
    after = solve(model, fits, world.truth, PRIOR)
    spread = np.sqrt(np.diag(after.covariance))[8]
    assert abs(after.calibration.offsets[2] - before.calibration.offsets[2]) < spread


def test_large_slip_of_roll_is_tolerated() -> None:
    world = make_world(12, seed=2)
    fits = world.fits(np.random.default_rng(0))
    outer = world.model.outer.copy()
    outer[5, 3] += np.deg2rad(45)
    slipped = replace(world, model=replace(world.model, outer=outer, joints=world.model.joints))
    model = learnt(slipped, fits)
    off = model.inflation[5, 0] * CONFIG.tail * model.deviations.outer[3]
    assert np.degrees(off) == pytest.approx(45, abs=10)
    solution = solve(model, fits, world.truth, PRIOR)
    assert solution.misfit[5] < CONFIG.largest_misfit * 9
    assert solution.weights[5] > 0.3
