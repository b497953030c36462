"""A tracker that keeps keyframes: their solution, following by it, and going on from a saved state."""

from __future__ import annotations

import itertools
import pickle
from dataclasses import replace

import numpy as np
import pytest
from helpers.moving_worlds import SMALL, MovingWorld, followed, moving_world
from helpers.transforms import moved

from dvrk_cmaes import EstimateConfig, KeyframeProblem, Rig, SessionCalibration, Solution, Tracker, TrackResult
from dvrk_cmaes.calibration.prediction import WRIST_ERROR, Prediction, lag_of
from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.track.confirmed_image import confirmed_by
from dvrk_cmaes.track.keyframe_store import NEW_AT_MOST, SOLVED_AT
from dvrk_cmaes.track.keyframes import MOST_KEYFRAMES
from dvrk_cmaes.track.known_base import CalibratedFollower
from dvrk_cmaes.track.reading_buffer import ReadingBuffer

CONFIG = EstimateConfig(trust=TrustConfig(tip_mm=3.0))
"""Settings for small images, which tell less about the depth."""


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world(right=0.004)


@pytest.fixture(scope="module")
def before(world: MovingWorld) -> tuple[Tracker, list[TrackResult]]:
    """A tracker that has followed until its keyframes are to be solved for the first time, and its results."""
    tracker, results = Tracker(world.camera, world.body, config=CONFIG), []
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
            assert used == (solution.keyframes == 12)
            assert not tracker.solution_due
            if used:
                break
    return tracker, solutions, results


def test_images_are_not_followed_by_few_keyframes_that_do_not_tell_the_lag(
    world: MovingWorld, solved: tuple[Tracker, dict[int, Solution], list[TrackResult]]
) -> None:
    _, solutions, results = solved
    lags = {count: lag_of(one.calibration, 0.1) for count, one in solutions.items() if one.calibration is not None}
    told = {count: lag.std for count, lag in lags.items() if lag is not None}
    assert list(solutions) == [4, 8, 12]
    assert told[8] > 0.055 > told[12]
    # but from 8 keyframes on, an image that these expect where it was followed to is ok, with the margin of the masks
    by_eight = [result for result in results if result.base is not None and result.base.solved == 8]
    assert {result.status for result in by_eight} == {"ok"}
    assert all(result.base is not None and not result.base.used for result in results)
    before = [result for result in results if result.base is not None and result.base.solved < 8]
    assert all(result.status != "ok" for result in before)


def test_image_is_not_confirmed_where_the_keyframes_expect_another_place(
    world: MovingWorld, solved: tuple[Tracker, dict[int, Solution], list[TrackResult]]
) -> None:
    _, solutions, results = solved
    calibration, result = solutions[8].calibration, results[-1]
    assert calibration is not None
    assert result.camera_from_root is not None
    assert result.covariance is not None
    readings = ReadingBuffer(world.body.instrument.joint_names, 0.2, 1.0)
    for k in range(len(results)):
        readings.add(world.time(k), world.readings[k])
    at = readings.at(result.time)
    for pitch, expected in ((0.0, True), (0.9, False)):
        turned = moved(result.camera_from_root, np.array([0.0, 0.0, 0.0, pitch, 0.0, 0.0]))
        other = replace(result, camera_from_root=turned)
        confirmed = confirmed_by(calibration, other, at, 0.08, followed(world, CONFIG))
        assert (confirmed is not None) == expected
    strict = replace(CONFIG, trust=TrustConfig(tip_mm=0.9 * (result.tip_std_mm or 0)))
    doubtful = confirmed_by(calibration, result, at, 0.08, followed(world, strict))
    assert doubtful is not None
    assert doubtful.status == "doubtful"
    assert doubtful.reasons[0].startswith("tips not accurate")


def test_calibration_expects_larger_errors_of_the_wrist_in_later_images(
    world: MovingWorld, solved: tuple[Tracker, dict[int, Solution], list[TrackResult]]
) -> None:
    calibration, instrument = solved[1][12].calibration, world.body.instrument
    assert calibration is not None
    readings = ReadingBuffer(instrument.joint_names, 0.2, 1.0)
    for k in range(len(solved[2])):
        readings.add(world.time(k), world.readings[k])
    at = readings.at(world.time(20))
    model, own = calibration.model(at.outer[None], at.joints[None], instrument.joint_names)
    std = np.sqrt(np.diag(model.covariance(own)[0]))
    readings_at = (calibration, at.outer[None], at.joints[None], instrument.joint_names)
    expected = np.sqrt(np.diag(Prediction.of(*readings_at, wrist=WRIST_ERROR).prior[0]))
    assert expected[:5] == pytest.approx(std[:5])
    assert expected[5:] == pytest.approx(2 * std[5:])
    late = np.sqrt(np.diag(Prediction.of(*readings_at, late=0.1 * at.rates[None], wrist=WRIST_ERROR).prior[0]))
    assert (late >= expected).all()
    assert late[:3].max() > 2 * expected[:3].max()


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
def calibration(before: tuple[Tracker, list[TrackResult]], world: MovingWorld) -> SessionCalibration:
    solution = before[0].problem().solve(world.body)
    assert solution.calibration is not None
    return solution.calibration


def test_earlier_calibration_is_ok_only_after_images_that_differ_agree(
    world: MovingWorld, calibration: SessionCalibration
) -> None:
    tracker = Tracker(world.camera, world.body, calibration, CONFIG, earlier=True)
    results = world.follow(tracker)
    first = next(k for k, result in enumerate(results) if result.status == "ok")
    assert results[0].status == "doubtful"
    assert results[0].reasons[-1].startswith("checking an earlier calibration: ")
    assert first >= 12  # five keyframes, each 0.09 s later than the one before
    assert np.mean([result.status == "ok" for result in results[first:]]) > 0.5


def test_earlier_calibration_is_given_up_where_the_camera_was_moved(calibration: SessionCalibration) -> None:
    elsewhere = moving_world(right=0.012)
    tracker = Tracker(elsewhere.camera, elsewhere.body, calibration, CONFIG, earlier=True, sliced=True)
    results = elsewhere.follow(tracker, frames=range(12))
    assert all(result.status != "ok" for result in results)
    assert tracker.base_state.startswith("calibrating: ")
    assert "base not known yet" in tracker.base_state


def test_images_that_show_little_of_the_instrument_do_not_tell_against_a_calibration(
    world: MovingWorld, calibration: SessionCalibration
) -> None:
    tracker = Tracker(world.camera, world.body, calibration, CONFIG)
    world.follow(tracker, frames=range(12))

    def sliver(k: int) -> np.ndarray:
        mask, rows = world.masks[k].copy(), np.flatnonzero(world.masks[k].any(axis=1))
        mask[rows[0] + 6 :] = False
        return mask

    hidden = world.follow(tracker, frames=range(12, 25), mask=sliver)
    assert sum(result.status == "lost" for result in hidden) > 10
    assert tracker.base_state.startswith("calibration given")
    again = world.follow(tracker, frames=range(25, 30))
    assert {result.status for result in again} == {"ok"}


def test_poses_by_a_doubtful_calibration_are_doubtful_for_its_reason(
    world: MovingWorld, calibration: SessionCalibration
) -> None:
    doubtful = replace(calibration, doubts=("the camera file is contradicted",), remarks=("lag: taken out",))
    results = world.follow(Tracker(world.camera, world.body, doubtful, CONFIG), frames=range(4))
    assert {result.status for result in results} == {"doubtful"}
    assert {result.reasons for result in results} == {("session: the camera file is contradicted",)}
    assert {result.remarks for result in results} == {("lag: taken out",)}


def test_solution_of_a_base_that_was_given_up_is_not_used(before: tuple[Tracker, list[TrackResult]]) -> None:
    tracker, _ = before
    other = replace(tracker.problem(), base=7)
    assert not tracker.use(Solution(None, "of another base", 4, {}, other.base))
    assert "of another base" not in tracker.base_state


def test_instrument_whose_readings_are_missing_is_followed_without_the_calibration(
    world: MovingWorld, calibration: SessionCalibration
) -> None:
    tracker = Tracker(world.camera, world.body, calibration, CONFIG, earlier=True)
    wrist = [{name: world.readings[k][name] for name in world.body.instrument.joint_names} for k in range(4)]
    results = world.follow(tracker, frames=range(4), readings=lambda k: wrist[k])
    assert all(result.camera_from_root is not None for result in results)
    assert {result.reasons[-1] for result in results} == {"no readings of the outer joints so far"}


def keep(known: CalibratedFollower, count: int) -> None:
    """Keep further images as keyframes, each farther from the one before than all others are from each other."""
    mask = np.zeros((SMALL.height, SMALL.width), np.bool_)
    mask[80:160, 100:200] = True
    for _ in range(count):
        k = known.store.taken
        readings = dict.fromkeys(OUTER_JOINTS, 0.0) | {"yaw": 0.02 * k**2}
        assert known.store.offer(0.1 * k, dict.fromkeys(Rig.of(SMALL).names, mask), {}, readings, {})


def failed(known: CalibratedFollower) -> Solution:
    """Return a solution without a calibration of all keyframes."""
    return Solution(None, "no calibration", len(known.problem().keyframes), {})


def test_keyframes_are_solved_at_some_numbers_and_when_a_third_of_the_most_are_new(world: MovingWorld) -> None:
    known = CalibratedFollower(followed(world, CONFIG), None)
    solved_at = []
    for number in range(1, MOST_KEYFRAMES + 2 * NEW_AT_MOST + 1):
        keep(known, 1)
        if known.due:
            solved_at.append(number)
            known.use(failed(known))
            assert not known.due
    assert solved_at == [*SOLVED_AT, MOST_KEYFRAMES + NEW_AT_MOST, MOST_KEYFRAMES + 2 * NEW_AT_MOST]


def test_solutions_have_at_most_twice_the_keyframes_of_those_before_and_the_last_ones_test_the_camera(
    world: MovingWorld,
) -> None:
    """Images came faster than keyframes were solved; the first few are then those that are farthest apart."""
    known, problems = (
        CalibratedFollower(followed(world, CONFIG), None),
        list[KeyframeProblem](),
    )
    keep(known, MOST_KEYFRAMES)
    first = [task.keyframe.name for task in known.unsolved[:4]]
    while known.due:
        problems.append(known.problem())
        known.use(Solution(None, "no calibration", len(problems[-1].keyframes), {}))
    names = [[one.name for one in problem.keyframes] for problem in problems]
    assert [len(each) for each in names] == [4, 8, 16, 32, MOST_KEYFRAMES]
    assert all(set(few) < set(more) for few, more in itertools.pairwise(names))
    assert set(first) == set(names[0]) >= {names[-1][0], names[-1][-1]}
    assert [problem.config.session.test_camera for problem in [*problems, known.problem()]] == [False] * 5 + [True]
