"""Least-squares solution of one calibration from many frames: exactness, robustness and covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import BASE, EXPECTED_OFFSETS, NAMES, SEEN, World, make_world
from helpers.transforms import change_between, moved, rotation_angle
from scipy.special import chdtri

from dvrk_cmaes.calibration.blocks import Base, Block, Calibration, Offsets
from dvrk_cmaes.calibration.solve import ArmFrames, FrameFits, Solved, leave_one_out, solution_at, solve, solve_arms
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.term import Quadratic


def a_start(world: World) -> Calibration:
    """Give a start 5 mm and 5 deg from the truth, with zero offsets."""
    off = np.array([3e-3, -3e-3, 3e-3, 0.05, -0.05, 0.05])
    return Calibration.of(moved(world.truth.camera_from_base, off), np.zeros(5), EXPECTED_OFFSETS)


def solved(world: World, fits: FrameFits) -> Solved:
    return solve(world.model, fits, a_start(world))


def error(world: World, found: Calibration) -> tuple[float, float]:
    """Give the error of the base: (deg, mm)."""
    true = world.truth.camera_from_base
    return (
        float(np.degrees(rotation_angle(true, found.camera_from_base))),
        float(1e3 * np.linalg.norm(true[:3, 3] - found.camera_from_base[:3, 3])),
    )


def test_exact_data_give_exact_base_and_offsets() -> None:
    world = make_world(noise=0)
    found = solve(
        world.model,
        world.fits(np.random.default_rng(0), 1e-4),
        Calibration.of(a_start(world).camera_from_base, np.zeros(5), 3e4 * EXPECTED_OFFSETS),
    )
    assert error(world, found.calibration) == pytest.approx((0, 0), abs=2e-3)
    np.testing.assert_allclose(found.calibration.offsets, world.truth.offsets, atol=2e-5)


def test_errors_agree_with_covariance() -> None:
    squared = []
    for seed in range(60):
        rng = np.random.default_rng(1000 + seed)
        offsets = EXPECTED_OFFSETS * rng.standard_normal(5)
        world = make_world(10, seed, offsets=offsets)
        found = solved(world, world.fits(rng))
        off = change_between(found.calibration.camera_from_base, world.truth.camera_from_base)
        squared.append(off @ np.linalg.solve(found.covariance[:6, :6], off))
    held = np.mean(np.array(squared) < chdtri(6, 1 - 0.95))
    assert 0.85 <= held <= 1.0
    assert np.median(squared) == pytest.approx(chdtri(6, 0.5), rel=0.4)


def test_errors_that_successive_frames_share_do_not_average_out() -> None:
    world, rng = make_world(80, noise=0), np.random.default_rng(0)
    own, shared = rng.standard_normal((80, 9)), np.repeat(rng.standard_normal((8, 9)), 10, axis=0)
    spreads = []
    for off in (own, shared):
        fits = replace(world.fits(rng), at=world.at.moved(off * SEEN))
        spreads.append(np.sqrt(np.diag(solved(world, fits).covariance)))
    of_offsets = (spreads[1] / spreads[0])[7:]  # the base follows from readings without errors
    assert of_offsets.mean() > 1.5


def test_third_of_frames_may_be_outliers() -> None:
    world = make_world(12, seed=4)
    right = world.fits(np.random.default_rng(5))
    poses = right.at.pose.copy()
    wild = np.random.default_rng(6).uniform(-1, 1, (4, 6)) * [0.02, 0.02, 0.02, 1.5, 1.5, 1.5]
    wild[:, :3] += 0.01
    poses[[1, 4, 7, 10]] = moved(poses[[1, 4, 7, 10]], wild)
    good, found = (
        solved(world, right),
        solve(world.model, replace(right, at=Posed(poses, right.at.joints)), world.truth),
    )
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
        again = solve(world.model.subset(others), fits.subset(others), whole.calibration)
        short = leave_one_out(whole, index)
        apart = change_between(again.calibration.camera_from_base, short.camera_from_base)
        spread = np.sqrt(np.diag(again.covariance))
        assert (np.abs(apart) < 0.02 * spread[:6]).all()
        assert (np.abs(again.calibration.offsets - short.offsets) < 0.02 * spread[6:]).all()


# further unknowns that all frames share


def with_further(world: World, fits: FrameFits, columns: np.ndarray, values: np.ndarray) -> FrameFits:
    """Let the outlines of ``fits`` shift by columns (N, D, E) times the differences of E unknowns from ``values``."""
    both = np.concatenate([np.tile(np.eye(9), (len(fits.at), 1, 1)), -columns], axis=2)
    information = np.swapaxes(both, 1, 2) @ fits.outlines.information @ both
    at = information @ np.concatenate([np.zeros(9), -values])
    return FrameFits(fits.at, Quadratic(information, at), {"some": np.zeros(len(values))})


@pytest.mark.parametrize("further", [0, 3])
def test_information_and_slope_are_the_derivatives_of_the_frames_cost(further: int) -> None:
    rng = np.random.default_rng(0)
    world = make_world(6, noise=0.1)
    columns = SEEN[:, None] * rng.standard_normal((6, 9, further))
    fits = with_further(world, world.fits(rng, 0.3), columns, np.zeros(further))
    scale = np.array([1e-4] * 3 + [1e-3] * 3 + [1e-4] + [1e-2] * 4 + [0.1] * further)
    free = Calibration.of(BASE, world.truth.offsets)
    start = free.with_blocks(Block("some", np.full(further, np.inf)), some=np.zeros(further))

    def half(step: np.ndarray) -> float:
        """Give half the sum of the frames' costs, whose weights are 1."""
        found = solution_at([ArmFrames(world.model, fits, start.changed(step))])[0]
        np.testing.assert_array_equal(found.weights, 1)
        return float(found.misfit.sum() / 2)

    found = solution_at([ArmFrames(world.model, fits, start)])[0]
    steps = np.diag(scale)
    slope = [(half(step) - half(-step)) / 2 for step in steps]
    curvature = [half(step) - 2 * half(0 * step) + half(-step) for step in steps]
    np.testing.assert_allclose(scale * found.frame_slopes.sum(axis=0), slope, rtol=0.01, atol=0.01)
    np.testing.assert_allclose(scale**2 * np.diag(found.information), curvature, rtol=0.01)


def test_further_unknowns_that_act_are_found_beside_the_calibration() -> None:
    rng = np.random.default_rng(3)
    world = make_world(20, seed=3)
    values = np.array([1.0, -2.0, 0.5])
    fits = with_further(world, world.fits(rng), SEEN[:, None] * rng.standard_normal((20, 9, 3)), values)
    found = solve(world.model, fits, a_start(world).with_blocks(Block("some", np.full(3, 100.0)), some=np.zeros(3)))
    std = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.calibration.further - values) < 3 * std[11:]).all()
    assert (std[11:] < 1).all()
    off = change_between(found.calibration.camera_from_base, world.truth.camera_from_base)
    assert (np.abs(off) < 3 * std[:6]).all()


class SharedBase(Base):
    """A base that two arms have in common."""

    shared = True


class SharedOffsets(Offsets):
    """Offsets that two arms have in common."""

    shared = True


def test_what_arms_share_stands_in_their_problem_once() -> None:
    """Frames in two arms that share all unknowns tell what they tell as those of one arm."""
    world = make_world(20)
    fits = world.fits(np.random.default_rng(1))
    whole = solve(world.model, fits, a_start(world))
    start = Calibration((SharedBase(), SharedOffsets(EXPECTED_OFFSETS, NAMES)), a_start(world).values)
    halves = [list(range(10)), list(range(10, 20))]
    one, other = solve_arms([ArmFrames(world.model.subset(own), fits.subset(own), start) for own in halves])
    np.testing.assert_allclose(one.calibration.camera_from_base, whole.calibration.camera_from_base, atol=1e-9)
    np.testing.assert_allclose(other.calibration.offsets, whole.calibration.offsets, atol=1e-9)
    np.testing.assert_allclose(one.whole.information, whole.information, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(one.information, whole.information, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(np.concatenate([one.weights, other.weights]), whole.weights, atol=1e-9)


def test_arms_that_share_nothing_are_solved_as_by_themselves() -> None:
    worlds = make_world(8, seed=1), make_world(12, seed=2)
    frames = [
        ArmFrames(world.model, world.fits(np.random.default_rng(seed)), a_start(world))
        for seed, world in enumerate(worlds)
    ]
    for both, own in zip(solve_arms(frames), frames, strict=True):
        alone = solve(*own)
        np.testing.assert_allclose(both.calibration.offsets, alone.calibration.offsets, atol=1e-5)
        np.testing.assert_allclose(both.information, alone.information, rtol=1e-3, atol=1e-3 * alone.information.max())


def test_an_arm_that_is_seen_well_helps_the_other_one_by_what_they_share() -> None:
    """Of an unknown with the effect of a roll of both arms, one arm tells much."""
    worlds = make_world(6, seed=1), make_world(40, seed=2)
    block = Block("some", np.ones(1))
    block.shared = True
    frames = []
    for seed, world in enumerate(worlds):
        columns = np.zeros((len(world.at), 9, 1))
        columns[:, 5] = 0.1
        fits = with_further(world, world.fits(np.random.default_rng(seed)), columns, np.zeros(1))
        start = Calibration.of(a_start(world).camera_from_base, np.zeros(5), np.array([1e-3, 0.02, 0.3, 0.3, 0.3]))
        frames.append(ArmFrames(world.model, fits, start.with_blocks(block, some=np.zeros(1))))
    alone, both = solve_arms(frames[:1])[0], solve_arms(frames)
    assert both[0].calibration.values["some"] == pytest.approx(both[1].calibration.values["some"])
    assert np.diag(both[0].covariance)[-1] < 0.8 * np.diag(alone.covariance)[-1]
