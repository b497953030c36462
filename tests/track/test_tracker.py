"""Following without a calibration: errors against the truth, losses and recovery, and the same answer again."""

from __future__ import annotations

import pickle
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier

import numpy as np
import pytest
from helpers.moving_worlds import MovingWorld, exact_mask, moving_world
from helpers.transforms import moved

from dvrk_cmaes import EstimateConfig, InputError, Result, Tracker, TrackResult, estimate


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world()


@pytest.fixture(scope="module")
def first(world: MovingWorld) -> Result:
    """The first frame solved by itself."""
    return estimate(world.masks[0], world.camera, world.readings[0], world.body)


def started(world: MovingWorld, first: Result, **options: object) -> Tracker:
    """Give a tracker that has the first frame's result."""
    tracker = Tracker(world.camera, world.body, lag=0.0, **options)  # type: ignore[arg-type]
    tracker.add_readings(world.time(0), world.readings[0])
    tracker.start(world.time(0), first)
    return tracker


@pytest.fixture(scope="module")
def results(world: MovingWorld, first: Result) -> list[TrackResult]:
    """The results of later frames."""
    return world.follow(started(world, first), frames=range(1, 26))


def errors_mm(world: MovingWorld, results: list[TrackResult], begin: int = 1) -> np.ndarray:
    return np.array([world.error_mm(begin + k, result) for k, result in enumerate(results)])


def test_errors_agree_with_their_standard_deviations(world: MovingWorld, results: list[TrackResult]) -> None:
    stated = np.array([result.tip_std_mm for result in results])
    assert 0.1 < np.median(errors_mm(world, results) / stated) < 2.0


def test_pickled_tracker_goes_on_with_same_results(
    world: MovingWorld, first: Result, results: list[TrackResult]
) -> None:
    tracker = started(world, first)
    world.follow(tracker, frames=range(1, 10))
    other = pickle.loads(pickle.dumps(tracker))
    for one, same in zip(world.follow(other, frames=range(10, 14)), results[9:13], strict=True):
        assert one.to_dict("a") | {"seconds": 0} == same.to_dict("a") | {"seconds": 0}
    assert not pickle.loads(pickle.dumps(Tracker(world.camera, world.body))).offsets


def test_steps_of_several_threads_are_done_one_after_the_other(world: MovingWorld, first: Result) -> None:
    def with_readings() -> Tracker:
        tracker = started(world, first)
        for k in range(1, 9):
            tracker.add_readings(world.time(k), world.readings[k])
        return tracker

    tracker, together = with_readings(), Barrier(8)

    def step(k: int) -> TrackResult | None:
        together.wait(60)
        try:
            return tracker.step(world.time(k), world.masks[k])
        except InputError:  # a thread with a later image was first
            return None

    with ThreadPoolExecutor(8) as pool:
        done = [*pool.map(step, range(1, 9))]
    assert done[-1] is not None
    again = with_readings()
    for k, result in enumerate(done, start=1):
        if result is not None:
            same = again.step(world.time(k), world.masks[k])
            assert result.to_dict("a") | {"seconds": 0} == same.to_dict("a") | {"seconds": 0}


def test_instrument_is_followed_without_readings(world: MovingWorld, first: Result) -> None:
    tracker = Tracker(world.camera, world.body)
    tracker.start(world.time(0), first)
    followed = world.follow(tracker, frames=range(1, 20), readings=lambda k: {})
    errors = errors_mm(world, followed)
    assert np.median(errors) < 0.8
    assert errors.max() < 3
    assert followed[-1].camera_from_base is None
    assert followed[-1].offsets == {}


def test_lag_that_is_given_is_that_of_the_readings(world: MovingWorld, first: Result) -> None:
    """Readings that come late by the given lag give the results of those that come in time."""
    late = Tracker(world.camera, world.body, lag=0.1)
    in_time = started(world, first)
    late.add_readings(world.time(0) - 0.1, world.readings[0])
    late.start(world.time(0), first)
    for k in range(1, 4):
        late.add_readings(world.time(k) - 0.1, world.readings[k])
        result, expected = late.step(world.time(k), world.masks[k]), world.follow(in_time, frames=range(k, k + 1))[0]
        assert world.error_mm(k, result) == pytest.approx(world.error_mm(k, expected), abs=1e-3)
    assert late.lag is not None
    assert late.lag.seconds == 0.1


# losses and recovery


def test_single_missing_masks_are_predicted(world: MovingWorld, first: Result) -> None:
    missing = (12, 13, 20)
    followed = world.follow(
        started(world, first), frames=range(1, 26), mask=lambda k: None if k in missing else world.masks[k]
    )
    for k in missing:
        assert followed[k - 1].status == "doubtful"
        assert followed[k - 1].reasons[0].startswith("no mask")
        assert world.error_mm(k, followed[k - 1]) < 2


def test_instrument_that_comes_back_elsewhere_is_searched(world: MovingWorld, first: Result) -> None:
    """Without readings, nothing tells where it went while it could not be seen."""
    empty, other = np.zeros_like(world.masks[0]), moving_world(20, seed=8)
    tracker = Tracker(world.camera, world.body)
    tracker.start(world.time(0), first)
    results = other.follow(
        tracker,
        frames=range(1, 20),
        readings=lambda k: {},
        mask=lambda k: world.masks[k] if k < 6 else empty if k < 8 else other.masks[k],
    )
    assert any(result.searched for result in results[8:])
    assert results[-1].status == "doubtful"
    assert np.linalg.norm(results[-1].camera_from_root[:3, 3] - other.truths[19].camera_from_root[:3, 3]) < 5e-3  # type: ignore[index]


def test_other_mask_does_not_support_the_pose(world: MovingWorld, first: Result) -> None:
    elsewhere = np.zeros_like(world.masks[0])
    elsewhere[10:60, 10:120] = True
    followed = world.follow(
        started(world, first), frames=range(1, 6), mask=lambda k: elsewhere if k > 2 else world.masks[k]
    )
    assert [result.status for result in followed[2:]] == ["lost"] * 3


def test_frozen_image_is_not_believed(world: MovingWorld, first: Result) -> None:
    followed = world.follow(started(world, first), frames=range(1, 16), mask=lambda k: world.masks[min(k, 8)])
    frozen = [result for result in followed[8:] if any(reason.startswith("frozen") for reason in result.reasons)]
    assert len(frozen) >= 3


def test_black_image_says_nothing(world: MovingWorld, first: Result) -> None:
    tracker = started(world, first)
    black = np.zeros((*world.masks[0].shape, 3), np.uint8)
    result = tracker.step(world.time(1), world.masks[1], image=black)
    assert result.status != "ok"
    assert result.reasons[0].startswith("black image")


def test_readings_that_stop_and_come_back_do_not_matter(world: MovingWorld, first: Result) -> None:
    followed = world.follow(
        started(world, first), frames=range(1, 26), readings=lambda k: world.readings[k] if not 8 <= k < 20 else {}
    )
    assert errors_mm(world, followed).max() < 1.5


def test_base_that_moved_is_followed(world: MovingWorld, first: Result) -> None:
    steered = moved(np.eye(4), [0.006, -0.004, 0.0, 0.0, 0.0, 0.05])
    after = [replace(truth, camera_from_root=steered @ truth.camera_from_root) for truth in world.truths]
    masks = [exact_mask(world.camera, truth) if k >= 8 else world.masks[k] for k, truth in enumerate(after[:20])]
    followed = world.follow(started(world, first), frames=range(1, 20), mask=lambda k: masks[k])
    assert np.linalg.norm(followed[-1].tips - after[19].tips, axis=1).mean() < 2e-3  # type: ignore[operator]


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda t, w: t.step(np.nan, w.masks[0]), "time: expected a finite number of seconds, got nan"),
        (lambda t, w: t.step(0.0, w.masks[0][:-1]), "mask: expected 320 x 240 pixels as the camera has"),
        (lambda t, w: t.step(0.0, w.masks[0], ignore=w.masks[0][1:]), "ignore: expected 320 x 240 pixels"),
        (lambda t, w: t.add_readings(0.0, {"elbow": 1.0}), "readings: unknown joint 'elbow'; expected one of "),
        (lambda t, w: t.add_readings(0.0, {"jaw": np.inf}), "readings: jaw: expected a finite number in rad, got inf"),
        (
            lambda t, w: t.add_readings(0.0, {"jaw": 1e308}),
            "readings: jaw: expected radians (at most 2 pi), got 1e+308",
        ),
        (lambda t, w: t.add_readings(np.inf, {}), "readings: time: expected a finite number of seconds, got inf"),
        (
            lambda t, w: t.start(0.0, Result.failed("a", "b", {}, instrument="lnd", root_link="roll_link")),
            "start: expected a result with a pose",
        ),
    ],
)
def test_wrong_input_is_refused(world: MovingWorld, call: object, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        call(Tracker(world.camera, world.body), world)  # type: ignore[operator]
    assert str(caught.value).startswith(expected)


def test_time_must_increase(world: MovingWorld, first: Result) -> None:
    tracker = started(world, first)
    with pytest.raises(InputError, match=r"time: expected a finite number of seconds later than 0 s, got 0"):
        tracker.step(0.0, world.masks[0])


def test_first_image_without_instrument_has_no_pose(world: MovingWorld) -> None:
    result = Tracker(world.camera, world.body).step(0.0, np.zeros_like(world.masks[0]))
    assert (result.status, result.camera_from_root) == ("lost", None)
    assert result.to_dict("0000")["camera_from_root"] is None


def test_settings_are_checked(world: MovingWorld) -> None:
    config = EstimateConfig()
    with pytest.raises(InputError, match=r"track\.lag_std"):
        Tracker(world.camera, world.body, config=replace(config, track=replace(config.track, lag_std=-1)))


# searches in the background


def test_step_does_not_wait_for_a_search_in_the_background(world: MovingWorld) -> None:
    """Steps say that they search until the search has ended; the next one has the pose at the present image."""
    tracker, results = Tracker(world.camera, world.body, background=True, lag=0.0), list[TrackResult]()
    for k in range(30):
        results += world.follow(tracker, frames=range(k, k + 1))
        time.sleep(0.2)
        if results[-1].camera_from_root is not None:
            break
    assert len(results) > 1
    assert all(result.reasons == ("searching: the image of 0.000 s",) for result in results[:-1])
    assert all(result.searched for result in results)
    assert world.error_mm(len(results) - 1, results[-1]) < 1.5
