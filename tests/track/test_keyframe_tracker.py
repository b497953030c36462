"""A tracker that keeps keyframes: their solution, following by it, and going on from a saved state."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from helpers.moving_worlds import SMALL, MovingWorld, moving_world

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig, TrustConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.track import Tracker
from dvrk_cmaes.track.keyframe_store import NEW_AT_MOST, SOLVED_AT, Solution
from dvrk_cmaes.track.keyframes import MOST_KEYFRAMES
from dvrk_cmaes.track.known_base import KnownBase

CONFIG = EstimateConfig(trust=TrustConfig(tip_mm=3.0))
"""Settings for small images, which tell less about the depth."""


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world()


@pytest.fixture(scope="module")
def before(world: MovingWorld) -> tuple[Tracker, list[TrackResult]]:
    """A tracker that has followed until its keyframes are to be solved for the first time, and its results."""
    tracker, results = Tracker(world.camera, world.body, config=CONFIG, keyframes=True), []
    for k in range(len(world.masks)):
        tracker.add_readings(world.time(k), world.readings[k])
        results.append(tracker.step(world.time(k), world.masks[k]))
        if tracker.solution_due:
            break
    assert tracker.solution_due
    return tracker, results


def step(tracker: Tracker, world: MovingWorld, k: int) -> TrackResult:
    tracker.add_readings(world.time(k), world.readings[k])
    return tracker.step(world.time(k), world.masks[k])


def test_no_pose_is_ok_before_a_solution(before: tuple[Tracker, list[TrackResult]]) -> None:
    _, results = before
    assert all(result.status != "ok" for result in results)
    assert "base not known yet: 4 keyframes" in results[-1].reasons[0]


def test_solution_is_followed_within_the_error_that_it_states(
    world: MovingWorld, before: tuple[Tracker, list[TrackResult]]
) -> None:
    tracker, results = before
    problem = pickle.loads(pickle.dumps(tracker.problem()))
    solution = problem.solve(world.body)
    assert solution.keyframes == 4
    assert tracker.use(solution)
    assert not tracker.solution_due
    saved = json.loads(json.dumps(tracker.checkpoint()))
    later = range(len(results), len(results) + 6)
    followed = [step(tracker, world, k) for k in later]
    errors = [world.error_mm(k, result) for k, result in zip(later, followed, strict=True)]
    assert max(errors) < 2.0
    assert all(error < 2 * (result.tip_std_mm or 0) for error, result in zip(errors, followed, strict=True))
    reasons = [result.reasons[0] for result in followed if result.status == "doubtful"]
    assert len(reasons) == len(followed)  # none is ok by so few keyframes
    assert np.mean([reason.startswith("too few keyframes to rely on: base known to") for reason in reasons]) > 0.5

    again = Tracker(world.camera, world.body, config=CONFIG, keyframes=True)
    for k in range(len(results)):
        again.add_readings(world.time(k), world.readings[k])
    again.restore(saved)
    assert [step(again, world, k).to_dict("") | {"seconds": 0} for k in later] == [
        result.to_dict("") | {"seconds": 0} for result in followed
    ]


def test_tracker_without_keyframes_has_nothing_to_solve(world: MovingWorld) -> None:
    with pytest.raises(InputError, match="keyframes=True"):
        Tracker(world.camera, world.body).solve()


@pytest.fixture(scope="module")
def calibration(before: tuple[Tracker, list[TrackResult]], world: MovingWorld) -> SessionCalibration:
    solution = before[0].problem().solve(world.body)
    assert solution.calibration is not None
    return solution.calibration


def test_earlier_calibration_is_ok_only_after_images_that_differ_agree(
    world: MovingWorld, calibration: SessionCalibration
) -> None:
    tracker = Tracker(world.camera, world.body, calibration, CONFIG, keyframes=True, earlier=True)
    results = world.follow(tracker)
    first = next(k for k, result in enumerate(results) if result.status == "ok")
    assert results[0].status == "doubtful"
    assert results[0].reasons[-1].startswith("checking an earlier calibration: ")
    assert first >= 12  # five keyframes, each 0.09 s later than the one before
    assert np.mean([result.status == "ok" for result in results[first:]]) > 0.5


def test_earlier_calibration_is_given_up_where_the_camera_was_moved(calibration: SessionCalibration) -> None:
    elsewhere = moving_world(right=0.012)
    tracker = Tracker(elsewhere.camera, elsewhere.body, calibration, CONFIG, keyframes=True, earlier=True, sliced=True)
    results = elsewhere.follow(tracker, frames=range(12))
    assert all(result.status != "ok" for result in results)
    assert tracker.base_state.startswith("calibrating: ")
    assert "base not known yet" in tracker.base_state


def test_solution_of_a_base_that_was_given_up_is_not_used(before: tuple[Tracker, list[TrackResult]]) -> None:
    tracker, _ = before
    other = replace(tracker.problem(), base=7)
    assert not tracker.use(Solution(None, "of another base", 4, {}, other.base))
    assert "of another base" not in tracker.base_state


def test_instrument_whose_readings_are_missing_is_followed_without_the_calibration(
    world: MovingWorld, calibration: SessionCalibration
) -> None:
    tracker = Tracker(world.camera, world.body, calibration, CONFIG, keyframes=True, earlier=True)
    results = world.follow(tracker, frames=range(4), readings=lambda k: {})
    assert all(result.camera_from_root is not None for result in results)


def keep(known: KnownBase, count: int) -> None:
    """Keep further images as keyframes, each farther from the one before than all others are from each other."""
    mask = np.zeros((SMALL.height, SMALL.width), np.bool_)
    mask[80:160, 100:200] = True
    for _ in range(count):
        k = known.store.taken
        readings = dict.fromkeys(OUTER_JOINTS, 0.0) | {"yaw": 0.02 * k**2}
        assert known.store.offer(0.1 * k, dict.fromkeys(Rig.of(SMALL).names, mask), {}, readings, {})


def failed(known: KnownBase) -> Solution:
    """Return a solution without a calibration of all keyframes."""
    return Solution(None, "no calibration", len(known.problem().keyframes), {})


def test_keyframes_are_solved_at_some_numbers_and_when_a_third_of_the_most_are_new(world: MovingWorld) -> None:
    known = KnownBase(Rig.of(world.camera), world.body, "classic", CONFIG, None)
    solved_at = []
    for number in range(1, MOST_KEYFRAMES + 2 * NEW_AT_MOST + 1):
        keep(known, 1)
        if known.due:
            solved_at.append(number)
            known.use(failed(known))
            assert not known.due
    assert solved_at == [*SOLVED_AT, MOST_KEYFRAMES + NEW_AT_MOST, MOST_KEYFRAMES + 2 * NEW_AT_MOST]


def test_state_of_the_keyframes_tells_how_many_of_them_are_new(world: MovingWorld) -> None:
    first, second = (KnownBase(Rig.of(world.camera), world.body, "classic", CONFIG, None) for _ in range(2))
    keep(first, MOST_KEYFRAMES)
    first.use(failed(first))
    keep(first, NEW_AT_MOST - 1)
    second.restore(json.loads(json.dumps(first.checkpoint())))
    assert (first.due, second.due) == (False, False)
    keep(second, 1)
    assert second.due
