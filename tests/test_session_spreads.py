"""How far readings are off from frame to frame is learnt; what slipped once neither widens it nor drags its frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from session_worlds import PRIOR, World, make_world

from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.solve import FrameViews, solve
from dvrk_cmaes.calibration.variances import learn_spreads
from dvrk_cmaes.config import SessionConfig

CONFIG = SessionConfig()


def learnt(world: World, views: FrameViews, turns: int = 6) -> SessionModel:
    """Solve and learn in turn, as a session does."""
    model, calibration = world.model, world.truth
    for _ in range(turns):
        solution = solve(model, views, calibration, PRIOR)
        calibration = solution.calibration
        model = learn_spreads(model, views, calibration, solution.weights, CONFIG)
    return model


def strayed(world: World, joint: int, degrees: np.ndarray) -> World:
    """Let a joint's readings be off by so much more in each frame, while the instrument is where it is."""
    joints = world.model.joints.copy()
    joints[:, joint] += np.deg2rad(degrees)
    return replace(world, model=world.model.of_readings(world.model.outer, joints))


def test_a_session_s_own_spread_is_found() -> None:
    rng = np.random.default_rng(0)
    world = make_world(80, noise=0)
    for joint, degrees in ((0, 0.5), (1, 3.0)):
        off = degrees * rng.standard_normal(80)
        model = learnt(strayed(world, joint, off), world.views(rng, 0.3))
        assert np.degrees(model.spreads.joints[joint]) == pytest.approx(off.std(), rel=0.2, abs=0.3)


def test_few_frames_do_not_pretend_to_know() -> None:
    world = make_world(3, noise=0)
    model = learnt(world, world.views(np.random.default_rng(0), 0.1))
    ratio = model.spreads.joints / world.model.spreads.joints
    assert (ratio > 0.3).all()
    assert (ratio < 1).all()


def test_the_arm_s_spreads_never_shrink_below_what_is_configured() -> None:
    world = make_world(40, noise=0)
    model = learnt(world, world.views(np.random.default_rng(0), 0.1))
    assert (model.spreads.outer[:3] >= world.model.spreads.outer[:3]).all()


def test_the_slack_of_the_whole_shrinks_where_nothing_is_left_to_explain() -> None:
    slack = make_world(1).model.spreads.slack
    world = make_world(40, noise=0)
    assert (learnt(world, world.views(np.random.default_rng(0), 0.02), 20).spreads.slack < 0.6 * slack).all()
    far = make_world(40, noise=8)
    assert (learnt(far, far.views(np.random.default_rng(0))).spreads.slack <= slack * (1 + 1e-9)).all()


def test_spreads_grow_only_so_far() -> None:
    rng = np.random.default_rng(1)
    world = strayed(make_world(40, noise=0), 0, 40 * rng.standard_normal(40))
    model = learnt(world, world.views(rng, 0.3))
    assert model.spreads.joints[0] <= CONFIG.cable_growth * np.deg2rad(CONFIG.wrist_deg) * (1 + 1e-9)


def test_a_slip_of_one_joint_neither_widens_the_spread_nor_drags_the_session() -> None:
    world = make_world(12, seed=2)
    views = world.views(np.random.default_rng(0))
    slipped = strayed(world, 0, np.array([0, 0, 0, 40.0] + [0] * 8))
    usual, model = learnt(world, views), learnt(slipped, views)
    assert model.spreads.joints[0] < 1.3 * usual.spreads.joints[0]
    assert model.stretch[3, 1] == pytest.approx(2.0)
    assert (np.delete(model.stretch[:, 1], 3) < 1.5).all()
    before = solve(usual, views, world.truth, PRIOR)
    after = solve(model, views, world.truth, PRIOR)
    spread = np.sqrt(np.diag(after.covariance))[8]
    assert abs(after.calibration.offsets[2] - before.calibration.offsets[2]) < spread


def test_a_slip_of_roll_is_forgiven_however_large() -> None:
    world = make_world(12, seed=2)
    views = world.views(np.random.default_rng(0))
    outer = world.model.outer.copy()
    outer[5, 3] += np.deg2rad(45)
    slipped = replace(world, model=world.model.of_readings(outer, world.model.joints))
    model = learnt(slipped, views)
    off = model.stretch[5, 0] * CONFIG.tail * model.spreads.outer[3]
    assert np.degrees(off) == pytest.approx(45, abs=10)
    solution = solve(model, views, world.truth, PRIOR)
    assert solution.misfit[5] < CONFIG.largest_misfit * 9
    assert solution.weights[5] > 0.3
