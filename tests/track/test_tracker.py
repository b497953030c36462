"""Following: errors against the truth, doubts, losses and recovery, and the same answer again."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers.moving_worlds import OFFSETS_ONLY, MovingWorld, moving_world

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.geometry import Posed, moved, rotation_angle
from dvrk_cmaes.results.result import Alternative, Result
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.synth.truth import exact_mask
from dvrk_cmaes.track import Tracker
from dvrk_cmaes.track.confirmation import CHANGED, UNCONFIRMED


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
    """The results of all later frames."""
    return world.follow(started(world, first), frames=range(1, len(world.truths)))


def errors_mm(world: MovingWorld, results: list[TrackResult], begin: int = 1) -> np.ndarray:
    return np.array([world.error_mm(begin + k, result) for k, result in enumerate(results)])


# a moving arm in view


def test_tips_are_followed_to_half_a_millimetre(world: MovingWorld, results: list[TrackResult]) -> None:
    errors = errors_mm(world, results)
    assert np.median(errors) < 0.5
    assert errors.max() < 1.5
    assert np.mean([result.status == "ok" for result in results]) >= 0.95


def test_errors_agree_with_their_standard_deviations(world: MovingWorld, results: list[TrackResult]) -> None:
    stated = np.array([result.tip_std_mm for result in results])
    assert 0.1 < np.median(errors_mm(world, results) / stated) < 2.0


def test_base_is_found(world: MovingWorld, results: list[TrackResult]) -> None:
    base = results[-1].camera_from_base
    assert base is not None
    assert np.degrees(rotation_angle(base, world.base)) < 6
    assert np.linalg.norm(base[:3, 3] - world.base[:3, 3]) < 2e-3


def test_same_input_gives_same_answer(world: MovingWorld, first: Result, results: list[TrackResult]) -> None:
    again = world.follow(started(world, first), frames=range(1, 8))
    for one, other in zip(again, results, strict=False):
        assert one.to_dict("a") | {"seconds": 0} == other.to_dict("a") | {"seconds": 0}


def test_checkpoint_goes_on_with_same_results(world: MovingWorld, first: Result, results: list[TrackResult]) -> None:
    tracker = started(world, first)
    world.follow(tracker, frames=range(1, 10))
    saved = json.loads(json.dumps(tracker.checkpoint()))
    other = Tracker(world.camera, world.body, lag=0.0)
    for k in range(10):
        other.add_readings(world.time(k), world.readings[k])
    other.restore(saved)
    for one, same in zip(world.follow(other, frames=range(10, 14)), results[9:13], strict=True):
        assert one.to_dict("a") | {"seconds": 0} == same.to_dict("a") | {"seconds": 0}


def test_pickled_tracker_goes_on_with_same_results(
    world: MovingWorld, first: Result, results: list[TrackResult]
) -> None:
    tracker = started(world, first)
    world.follow(tracker, frames=range(1, 10))
    other = pickle.loads(pickle.dumps(tracker))
    for one, same in zip(world.follow(other, frames=range(10, 14)), results[9:13], strict=True):
        assert one.to_dict("a") | {"seconds": 0} == same.to_dict("a") | {"seconds": 0}
    assert not pickle.loads(pickle.dumps(Tracker(world.camera, world.body))).offsets


def test_smoothing_does_not_increase_errors(world: MovingWorld, first: Result, results: list[TrackResult]) -> None:
    tracker = started(world, first, record=True)
    world.follow(tracker, frames=range(1, len(world.truths)))
    smooth = errors_mm(world, tracker.smoothed())
    assert np.percentile(smooth, 95) < np.percentile(errors_mm(world, results), 95)


def test_instrument_is_followed_without_readings(world: MovingWorld, first: Result) -> None:
    tracker = Tracker(world.camera, world.body)
    tracker.start(world.time(0), first)
    followed = world.follow(tracker, frames=range(1, 30), readings=lambda k: {})
    errors = errors_mm(world, followed)
    assert np.median(errors) < 0.8
    assert errors.max() < 3
    assert followed[-1].camera_from_base is None
    assert followed[-1].offsets == {}


def test_lag_of_images_is_found() -> None:
    late = moving_world(80, 5, replace(OFFSETS_ONLY, speed=2.5, lag=2.6))
    tracker = Tracker(late.camera, late.body)
    late.follow(tracker)
    assert tracker.lag is not None
    assert tracker.lag.seconds == pytest.approx(2.6 / 30, abs=0.02)


# modes


def test_mode_that_readings_do_not_predict_is_less_probable(world: MovingWorld, first: Result) -> None:
    """Both modes fit the images once they are corrected, but the first one has to be moved far for that."""
    truth = world.truths[0]
    mode = Alternative(truth.camera_from_root, truth.joints, 0.1, 0.95, "other mode")
    away = moved(truth.camera_from_root, [2e-3, 0.0, 0.0, 0.0, 0.0, 0.0])
    known = np.diag([1e-4] * 3 + [5e-3] * 6) ** 2
    start = replace(first, camera_from_root=away, joints=truth.joints, covariance=known, alternatives=(mode,))
    (result,) = world.follow(started(world, start), frames=range(1, 2))
    assert result.reasons == ("switched to the other mode: it explains the images better",)
    assert world.error_mm(1, result) < 0.4


def test_readings_that_are_frozen_still_tell_the_mode(world: MovingWorld, first: Result) -> None:
    tracker = Tracker(world.camera, world.body, lag=0.0)
    for k in range(-15, 1):
        tracker.add_readings(world.time(k), world.readings[0])
    tracker.start(world.time(0), replace(first, status="doubtful", reasons=("mode in doubt",)))
    followed = world.follow(tracker, frames=range(1, 10), readings=lambda k: world.readings[0])
    assert followed[0].reasons == (UNCONFIRMED,)
    assert followed[-1].status == "ok"
    assert world.error_mm(9, followed[-1]) < 1.5


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
    assert followed[-1].status == "ok"


def test_instrument_that_is_gone_is_lost_and_found_again(world: MovingWorld, first: Result) -> None:
    empty = np.zeros_like(world.masks[0])
    gone = range(10, 20)
    followed = world.follow(
        started(world, first), frames=range(1, 30), mask=lambda k: empty if k in gone else world.masks[k]
    )
    assert {followed[k - 1].status for k in gone} == {"lost"}
    stds = [followed[k - 1].tip_std_mm for k in gone]
    assert all(later > earlier for earlier, later in pairwise(stds))  # type: ignore[operator]
    assert followed[-1].status == "ok"
    assert world.error_mm(29, followed[-1]) < 1.5


def test_mask_of_which_the_instrument_is_a_small_part_does_not_support_it(world: MovingWorld, first: Result) -> None:
    rows, columns = np.indices(world.masks[1].shape)
    squares = (rows // 12 + columns // 12) % 2 == 0
    (result,) = world.follow(started(world, first), frames=range(1, 2), mask=lambda k: world.masks[k] | squares)
    assert result.status == "lost"


def test_other_mask_is_never_ok(world: MovingWorld, first: Result) -> None:
    elsewhere = np.zeros_like(world.masks[0])
    elsewhere[10:60, 10:120] = True
    followed = world.follow(
        started(world, first), frames=range(1, 6), mask=lambda k: elsewhere if k > 2 else world.masks[k]
    )
    assert [result.status for result in followed[2:]] == ["lost"] * 3


def test_frozen_image_is_not_believed(world: MovingWorld, first: Result) -> None:
    followed = world.follow(started(world, first), frames=range(1, 20), mask=lambda k: world.masks[min(k, 10)])
    frozen = [result for result in followed[10:] if any(reason.startswith("frozen") for reason in result.reasons)]
    assert len(frozen) >= 3
    assert "ok" not in {result.status for result in frozen}


def test_black_image_says_nothing(world: MovingWorld, first: Result) -> None:
    tracker = started(world, first)
    black = np.zeros((*world.masks[0].shape, 3), np.uint8)
    result = tracker.step(world.time(1), world.masks[1], image=black)
    assert result.status != "ok"
    assert result.reasons[0].startswith("black image")


def test_readings_that_stop_are_replaced_by_velocity(world: MovingWorld, first: Result) -> None:
    followed = world.follow(
        started(world, first), frames=range(1, 34), readings=lambda k: world.readings[k] if not 10 <= k < 24 else {}
    )
    assert errors_mm(world, followed).max() < 3
    assert followed[-1].status == "ok"


def test_base_that_moved_is_found_again(world: MovingWorld, first: Result) -> None:
    steered = moved(np.eye(4), [0.006, -0.004, 0.0, 0.0, 0.0, 0.05])
    after = [replace(truth, camera_from_root=steered @ truth.camera_from_root) for truth in world.truths]
    masks = [exact_mask(world.body, world.camera, truth) if k >= 8 else world.masks[k] for k, truth in enumerate(after)]
    followed = world.follow(started(world, first), frames=range(1, 24), mask=lambda k: masks[k])
    wrong = [
        k
        for k in range(8, 24)
        if followed[k - 1].status == "ok" and np.linalg.norm(followed[k - 1].tips - after[k].tips, axis=1).mean() > 3e-3  # type: ignore[operator]
    ]
    assert not wrong
    last = followed[-1]
    assert last.status == "ok"
    assert np.linalg.norm(last.tips - after[23].tips, axis=1).mean() < 2e-3  # type: ignore[operator]


@pytest.mark.parametrize("turn_deg", [-60, -25, 40])
def test_roll_that_no_reading_tells_is_found_at_once(world: MovingWorld, first: Result, turn_deg: float) -> None:
    turned = moved(np.eye(4), [0, 0, 0, 0, 0, np.deg2rad(turn_deg)])
    truths = [
        replace(truth, camera_from_root=truth.camera_from_root @ turned) if k >= 12 else truth
        for k, truth in enumerate(world.truths)
    ]
    masks = [exact_mask(world.body, world.camera, truth) for truth in truths[:24]]
    after = replace(world, truths=truths, masks=masks)
    frozen = world.readings[0]
    followed = after.follow(started(world, first), frames=range(1, 24), readings=lambda _: frozen)
    errors = errors_mm(after, followed)
    assert errors[13:].max() < 1.5
    assert not [k for k, one in enumerate(followed) if one.status == "ok" and errors[k] > 3]
    assert followed[-1].status == "ok"


@pytest.fixture(scope="module")
def astray(world: MovingWorld, first: Result) -> Result:
    """A result in doubt of the first image, 14 mm off: by itself, no later image leads from there to the true pose."""
    names, truth = world.body.instrument.joint_names, world.truths[0]
    right = Posed(truth.camera_from_root, np.array([truth.joints[name] for name in names]))
    wrong = right.moved(np.array([0.0, 0.0, 0.01, 0.1, 0.0, 0.0, 0.4, 0.0, 0.0]))
    joints = dict(zip(names, wrong.joints.tolist(), strict=True))
    known = np.diag([1e-3] * 3 + [2e-2] * 3 + [5e-2] * 3) ** 2
    doubtful = replace(first, status="doubtful", reasons=("mode in doubt",), alternatives=())
    return replace(doubtful, camera_from_root=wrong.pose, joints=joints, covariance=known)


def test_first_image_in_doubt_is_never_ok_and_wrong(world: MovingWorld, astray: Result) -> None:
    followed = world.follow(started(world, astray), frames=range(1, 24))
    errors = errors_mm(world, followed)
    assert errors[0] > 3  # the first image leads astray
    assert not [k for k, one in enumerate(followed) if one.status == "ok" and errors[k] > 3]
    assert followed[0].reasons[0] == UNCONFIRMED
    assert followed[-1].status == "ok"


@pytest.mark.parametrize("least_mm", [0.3, 10.0])
def test_doubt_is_settled_by_the_same_image_however_uncertain_poses_are(
    world: MovingWorld, astray: Result, least_mm: float
) -> None:
    """The count of images does not hang on a standard deviation that stays near the largest that is ok."""
    config = EstimateConfig()
    config = replace(config, track=replace(config.track, largest_tip_mm=least_mm))
    followed = world.follow(started(world, astray, config=config), frames=range(1, 8))
    assert [one.reasons[0] == CHANGED for one in followed[:6]] == [False] * 4 + [True, False]


# wrong use


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda t, w: t.step(np.nan, w.masks[0]), "time: expected a finite number of seconds, got nan"),
        (lambda t, w: t.step(0.0, w.masks[0][:-1]), "mask: expected 320 x 240 pixels as the camera has"),
        (lambda t, w: t.step(0.0, w.masks[0], ignore=w.masks[0][1:]), "ignore: expected 320 x 240 pixels"),
        (lambda t, w: t.add_readings(0.0, {"elbow": 1.0}), "readings: unknown joint 'elbow'; expected one of: "),
        (lambda t, w: t.add_readings(0.0, {"jaw": np.inf}), "readings: jaw: expected a finite number in rad, got inf"),
        (
            lambda t, w: t.add_readings(0.0, {"jaw": 1e308}),
            "readings: jaw: expected radians (at most 2 pi), got 1e+308",
        ),
        (lambda t, w: t.add_readings(np.inf, {}), "readings: time: expected a finite number of seconds, got inf"),
        (lambda t, w: t.smoothed(), "smoothed: expected a tracker that records"),
        (lambda t, w: t.restore({}), "checkpoint: expected the state of a tracker"),
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
    with pytest.raises(InputError, match=r"track\.reach_px"):
        Tracker(world.camera, world.body, config=replace(config, track=replace(config.track, reach_px=-1.0)))
