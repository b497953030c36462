"""A tracker whose searches go on in later steps: the first pose, and a pose that is found again."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from helpers.moving_worlds import MovingWorld, moving_world

from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.silhouette import sliced_call
from dvrk_cmaes.synth.images import draw_image
from dvrk_cmaes.track import Tracker, sliced_following
from dvrk_cmaes.track.sliced_following import LEAST_SEARCHED, STEP


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world()


def followed(world: MovingWorld) -> list[TrackResult]:
    return world.follow(Tracker(world.camera, world.body, sliced=True, lag=0.0))


@pytest.fixture(scope="module")
def results(world: MovingWorld) -> list[TrackResult]:
    return followed(world)


def test_steps_say_that_they_search_until_the_first_pose(results: list[TrackResult]) -> None:
    first = next(k for k, result in enumerate(results) if result.camera_from_root is not None)
    assert first > 3
    assert results[0].reasons == ("searching: the image of 0.000 s",)
    assert all(reason.startswith("searching: ") for result in results[:first] for reason in result.reasons)
    assert all(result.searched for result in results[: first + 1])
    assert not any(result.searched for result in results[first + 1 :])


def test_first_pose_is_followed_to_the_image_that_is_present(world: MovingWorld, results: list[TrackResult]) -> None:
    errors = [world.error_mm(k, result) for k, result in enumerate(results) if result.tips is not None]
    assert len(errors) > 10
    assert max(errors) < 1.5


def test_same_images_give_same_results(world: MovingWorld, results: list[TrackResult]) -> None:
    assert [result.to_dict("") | {"seconds": 0} for result in followed(world)] == [
        result.to_dict("") | {"seconds": 0} for result in results
    ]


def test_no_step_of_a_search_draws_much_more_than_a_slice(world: MovingWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    tracker, largest = Tracker(world.camera, world.body, sliced=True, lag=0.0), []
    counted = 0
    worked = sliced_call._Call.worked

    def count(self: sliced_call._Call, rows: int) -> None:
        nonlocal counted
        counted += rows
        worked(self, rows)

    monkeypatch.setattr(sliced_call._Call, "worked", count)
    for k in range(8):
        before = counted
        world.follow(tracker, frames=range(k, k + 1))
        largest.append(counted - before)
    assert 0 < max(largest) < 20000
    assert counted > 3 * 6000


def test_first_image_without_a_mask_is_segmented_in_slices_that_say_so(world: MovingWorld) -> None:
    """The mask is found in several steps before the pose is searched."""
    image = draw_image(world.camera, world.truths[0], np.random.default_rng(5))
    tracker = Tracker(world.camera, world.body, sliced=True, lag=0.0, evidence="images")
    tracker.add_readings(world.time(0), world.readings[0])
    said = []
    for k in range(60):
        result = tracker.step(world.time(k), image=image)
        if result.camera_from_root is not None:
            break
        said.append(result.reasons[0].split(":")[0])
    assert result.camera_from_root is not None
    assert said.count("segmenting") >= 5
    assert "segmenting" not in said[said.index("searching") :]
    assert world.error_mm(0, result) < 3.0


def test_search_that_goes_on_is_not_saved(world: MovingWorld) -> None:
    tracker = Tracker(world.camera, world.body, lag=0.0, sliced=True)
    world.follow(tracker, frames=range(3))
    assert tracker.searching
    again = Tracker(world.camera, world.body, lag=0.0, sliced=True)
    for k in range(3):
        again.add_readings(world.time(k), world.readings[k])
    again.restore(tracker.checkpoint())
    assert not again.searching
    (result,) = world.follow(again, frames=range(3, 4))
    assert result.reasons == ("searching: the image of 0.100 s",)


def test_step_of_a_lost_instrument_does_bounded_work(world: MovingWorld) -> None:
    """Masks that contradict the pose are searched around and globally, and the steps are hardly longer for that."""
    tracker = Tracker(world.camera, world.body, sliced=True, lag=0.0)
    drawn, rows, statuses = [], [], []

    def mask(k: int) -> np.ndarray:
        return world.masks[k] if k < 22 or k >= 34 else np.ascontiguousarray(world.masks[k][::-1])

    for k in range(40):
        with sliced_call.counted_work() as work:
            (result,) = world.follow(tracker, frames=range(k, k + 1), mask=mask)
        drawn.append(work.drawings)
        rows.append(work.rows)
        statuses.append(result.status)
    assert "ok" in statuses[:22]
    assert "lost" in statuses[22:34]
    assert min(rows[22:30]) > 3 * max(rows[17:22])  # it did search
    most_at_once = 16 * world.camera.height + 100
    assert max(rows) <= STEP + LEAST_SEARCHED + most_at_once
    assert max(drawn[22:34]) <= 30


def test_lost_instrument_is_found_again_although_images_wait(world: MovingWorld) -> None:
    tracker = Tracker(world.camera, world.body, sliced=True, lag=0.0)
    results = world.follow(
        tracker, mask=lambda k: world.masks[k] if not 22 <= k < 26 else np.zeros_like(world.masks[k])
    )
    assert not tracker.searching
    assert world.error_mm(39, results[39]) < 1.5


def test_image_that_is_not_done_with_in_its_step_has_its_prediction(
    world: MovingWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With steps of little work, images wait: their predictions are stated, as lost, by the readings of their time."""
    tracker = Tracker(world.camera, world.body, sliced=True, lag=0.0)
    world.follow(tracker, frames=range(20))
    assert not tracker.searching
    monkeypatch.setattr(sliced_following, "STEP", 500.0)
    (result,) = world.follow(tracker, frames=range(20, 21))
    assert tracker.searching
    assert (result.status, result.searched) == ("lost", True)
    assert "1 behind" in result.reasons[0]
    assert world.error_mm(20, result) < 1.5
    monkeypatch.undo()
    (result,) = world.follow(tracker, frames=range(21, 22))
    assert not tracker.searching
    assert result.status == "ok"


def test_state_while_an_image_waits_is_that_of_the_image_before(
    world: MovingWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker = Tracker(world.camera, world.body, sliced=True, lag=0.0)
    world.follow(tracker, frames=range(20))
    saved = tracker.checkpoint()
    monkeypatch.setattr(sliced_following, "STEP", 500.0)
    world.follow(tracker, frames=range(20, 21))
    later = tracker.checkpoint()
    assert later["by_filter"] == saved["by_filter"] == world.time(19)
    assert later["hypotheses"] == saved["hypotheses"]


def test_tracker_that_is_dropped_while_images_wait_ends_its_threads(
    world: MovingWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = set(threading.enumerate())
    tracker = Tracker(world.camera, world.body, sliced=True, lag=0.0)
    world.follow(tracker, frames=range(20))
    monkeypatch.setattr(sliced_following, "STEP", 500.0)
    world.follow(tracker, frames=range(20, 21))
    waiting = set(threading.enumerate()) - before
    assert waiting
    del tracker
    for thread in waiting:
        thread.join(60)
        assert not thread.is_alive()
