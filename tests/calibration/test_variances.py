"""Variance components of the readings' errors, estimated from a session, and their robustness to single slips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import World, make_world

from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.solve import FrameFits, solve
from dvrk_cmaes.calibration.variances import estimate_variances
from dvrk_cmaes.config import SessionConfig

CONFIG = SessionConfig()


def learnt(world: World, fits: FrameFits, turns: int = 6) -> SessionModel:
    """Alternate between solving and estimating the variances, as the calibration of a session does."""
    model, calibration = world.model, world.truth
    for _ in range(turns):
        solution = solve(model, fits, calibration)
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


def test_slip_of_one_joint_changes_its_frame_only() -> None:
    world = make_world(12, seed=2)
    fits = world.fits(np.random.default_rng(0))
    slipped = strayed(world, 0, np.array([0, 0, 0, 40.0] + [0] * 8))
    usual, model = learnt(world, fits), learnt(slipped, fits)
    assert model.deviations.joints[0] < 1.3 * usual.deviations.joints[0]
    assert model.inflation[3, 1] == pytest.approx(2.0)
    assert (np.delete(model.inflation[:, 1], 3) < 1.5).all()
    before = solve(usual, fits, world.truth)
    after = solve(model, fits, world.truth)
    spread = np.sqrt(np.diag(after.covariance))[8]
    assert abs(after.calibration.offsets[2] - before.calibration.offsets[2]) < spread
