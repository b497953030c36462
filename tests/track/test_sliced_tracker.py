"""A tracker whose searches go on in later steps: the first pose, and a pose that is found again."""

from __future__ import annotations

import gc
import threading

import numpy as np
import pytest
from helpers.moving_worlds import MovingWorld, moving_world

from dvrk_cmaes import InputError, Tracker, TrackResult
from dvrk_cmaes.silhouette import sliced_call
from dvrk_cmaes.track.unknown_base import STEP_OF_SEARCH


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
    assert all(result.reasons[0].startswith("searching: ") for result in results[:first])
    assert all(result.searched for result in results[: first + 1])
    assert not any(result.searched for result in results[first + 1 :])


def test_first_pose_is_followed_to_the_image_that_is_present(world: MovingWorld, results: list[TrackResult]) -> None:
    errors = [world.error_mm(k, result) for k, result in enumerate(results) if result.tips is not None]
    assert len(errors) > 10
    assert max(errors) < 1.5


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


def test_step_of_a_lost_instrument_does_bounded_work(world: MovingWorld) -> None:
    """Masks that contradict the pose are searched, and no step does more than its slice and some fits."""
    tracker = Tracker(world.camera, world.body, sliced=True, lag=0.0)
    rows, searched = [], []

    def mask(k: int) -> np.ndarray:
        return world.masks[k] if k < 22 or k >= 34 else np.ascontiguousarray(world.masks[k][::-1])

    for k in range(40):
        with sliced_call.counted_work() as work:
            (result,) = world.follow(tracker, frames=range(k, k + 1), mask=mask)
        rows.append(work.rows)
        searched.append(result.searched)
    assert any(searched[22:34])
    followed = max(rows[18:22])
    most_at_once = 16 * world.camera.height + 100
    assert max(rows) <= STEP_OF_SEARCH + 4 * 3 * followed + most_at_once


def test_lost_instrument_is_found_again(world: MovingWorld) -> None:
    tracker = Tracker(world.camera, world.body, sliced=True, lag=0.0)
    results = world.follow(
        tracker, mask=lambda k: world.masks[k] if not 22 <= k < 26 else np.zeros_like(world.masks[k])
    )
    assert not tracker.searching
    assert world.error_mm(39, results[39]) < 1.5


def test_tracker_that_is_dropped_during_a_search_ends_its_thread(world: MovingWorld) -> None:
    before = set(threading.enumerate())
    tracker = Tracker(world.camera, world.body, sliced=True, lag=0.0)
    world.follow(tracker, frames=range(3))
    assert tracker.searching
    waiting = set(threading.enumerate()) - before
    assert waiting
    del tracker
    gc.collect()  # the search refers to the tracker's part that it is a part of
    for thread in waiting:
        thread.join(60)
        assert not thread.is_alive()


def test_two_threads_may_step_one_tracker(world: MovingWorld) -> None:
    tracker = Tracker(world.camera, world.body, sliced=True, lag=0.0)
    together = threading.Barrier(2)
    found: list[TrackResult] = []
    refused: list[str] = []

    def steps(later: float) -> None:
        for k in range(12):
            together.wait(timeout=60)
            try:
                found.append(tracker.step(world.time(k) + later, world.masks[k]))
            except InputError as error:
                refused.append(str(error))

    threads = [threading.Thread(target=steps, args=(later,), daemon=True) for later in (0.0, 1e-3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    assert not any(thread.is_alive() for thread in threads)
    assert len(found) + len(refused) == 24
    assert all("later than" in text for text in refused)
    assert any(result.camera_from_root is not None for result in found)
