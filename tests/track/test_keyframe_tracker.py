"""A tracker that keeps keyframes: their solution, following by it, and going on from a saved state."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from helpers.moving_worlds import MovingWorld, moving_world

from dvrk_cmaes import EstimateConfig, SessionCalibration, Solution, Tracker, TrackResult

pytestmark = pytest.mark.usefixtures("searches_short")

OUTER_JOINTS = ("yaw", "pitch", "insertion", "roll")
CONFIG = replace(EstimateConfig(), trust=replace(EstimateConfig().trust, tip_mm=3.0))
"""Settings for small images, which tell less about the depth."""


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world(right=0.004)


def step(tracker: Tracker, world: MovingWorld, k: int) -> TrackResult:
    tracker.add_readings(world.time(k), world.readings[k])
    return tracker.step(world.time(k), world.masks[k])


@pytest.mark.parametrize("outer", ["never read", "read 2 s before the images", "standing still"])
def test_no_pose_is_ok_before_the_base_is_known_whatever_is_read(world: MovingWorld, outer: str) -> None:
    """Each of these leaves the base unknown, and the images are followed by their masks and the wrist's readings."""
    tracker = Tracker(world.camera, world.body, config=CONFIG)
    for k in range(-15, 0) if outer != "never read" else ():
        tracker.add_readings(world.time(k) - (2 if outer.startswith("read") else 0), world.readings[0])
    read = OUTER_JOINTS if outer == "standing still" else world.body.instrument.joint_names
    frames = [{name: world.readings[0 if name in OUTER_JOINTS else k][name] for name in read} for k in range(12)]
    results = world.follow(tracker, frames=range(12), readings=lambda k: frames[k])
    assert {result.status for result in results} == {"doubtful"}
    assert results[-1].reasons[0].startswith("base not known yet: 0 keyframes")


@pytest.mark.parametrize(("speed", "sparse"), [(1, False), (8, True)])
def test_readings_that_are_too_sparse_for_the_motion_are_a_reason(
    world: MovingWorld, speed: int, *, sparse: bool
) -> None:
    """Every fourth image has readings, which come 50 ms late; the arm's own motion is slow, and a swing is added."""
    tracker = Tracker(world.camera, world.body, config=CONFIG)
    results = []
    for k in range(24):
        if k % 4 == 0 and k:
            swing = 0.2 * np.sin(speed * (world.time(k) - 0.05)) if sparse else 0.0
            tracker.add_readings(
                world.time(k) - 0.05, world.readings[k - 1] | {"yaw": world.readings[k]["yaw"] + swing}
            )
        results.append(tracker.step(world.time(k), world.masks[k]))
    assert any("readings too sparse: every 133 ms" in " ".join(one.reasons) for one in results) == sparse
    later = [one for one in tracker.problem().keyframes if one.time > 0.4]  # than the third readings, which first tell
    assert bool(later) != sparse


@pytest.fixture(scope="module")
def solved(world: MovingWorld) -> tuple[Tracker, dict[int, Solution], list[TrackResult]]:
    """A tracker that has used its solutions up to that of 12 keyframes, these, and the results until then."""
    tracker, solutions, results = Tracker(world.camera, world.body, config=CONFIG), {}, []
    for k in range(len(world.masks)):
        results.append(step(tracker, world, k))
        if tracker.solution_due:
            problem = pickle.loads(pickle.dumps(tracker.problem()))
            solution = problem.solve(world.body)
            solutions[solution.keyframes] = solution
            used = tracker.use(solution)
            assert used or solution.tip_mm > CONFIG.trust.tip_mm
            assert not tracker.solution_due
            if solution.keyframes == 12:
                break
    return tracker, solutions, results


def test_solution_is_followed_within_the_error_that_it_states(
    world: MovingWorld, solved: tuple[Tracker, dict[int, Solution], list[TrackResult]]
) -> None:
    tracker, _, results = solved
    again = pickle.loads(pickle.dumps(tracker))
    later = range(len(results), len(results) + 5)
    followed = [step(tracker, world, k) for k in later]
    errors = [world.error_mm(k, result) for k, result in zip(later, followed, strict=True)]
    assert max(errors) < 1.0
    assert all(error < 2 * (result.tip_std_mm or 0) for error, result in zip(errors, followed, strict=True))
    assert {result.status for result in followed} == {"ok"}
    assert [step(again, world, k).to_dict("") | {"seconds": 0} for k in later] == [
        result.to_dict("") | {"seconds": 0} for result in followed
    ]


@pytest.fixture(scope="module")
def calibration(solved: tuple[Tracker, dict[int, Solution], list[TrackResult]]) -> SessionCalibration:
    found = solved[1][12].calibration
    assert found is not None
    return found


def test_given_calibration_is_given_up_where_the_camera_was_moved(calibration: SessionCalibration) -> None:
    elsewhere = moving_world(right=0.012, shown=16)
    tracker = Tracker(elsewhere.camera, elsewhere.body, calibration, CONFIG)
    results = elsewhere.follow(tracker, frames=range(16))
    assert all(result.status != "ok" for result in results)
    assert tracker.base_state.startswith("calibrating: ")
    assert "base not known yet" in tracker.base_state


def test_solution_of_a_base_that_was_given_up_is_not_used(
    solved: tuple[Tracker, dict[int, Solution], list[TrackResult]],
) -> None:
    tracker, *_ = solved
    other = replace(tracker.problem(), base=7)
    assert not tracker.use(Solution(None, "of another base", 4, {}, other.base))
    assert "of another base" not in tracker.base_state


def test_instrument_whose_readings_are_missing_is_followed_without_the_calibration(
    world: MovingWorld, calibration: SessionCalibration
) -> None:
    tracker = Tracker(world.camera, world.body, calibration, CONFIG)
    wrist = [{name: world.readings[k][name] for name in world.body.instrument.joint_names} for k in range(4)]
    results = world.follow(tracker, frames=range(4), readings=lambda k: wrist[k])
    assert all(result.camera_from_root is not None for result in results)
    assert {result.reasons[-1] for result in results} == {"no readings of the outer joints so far"}
