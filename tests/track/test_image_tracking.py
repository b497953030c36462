"""Following by images without masks: errors against the truth, losses, and mixtures with masks."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.moving_worlds import MovingWorld, drawn, moving_world

from dvrk_cmaes import Result, Rig, Tracker, TrackResult, estimate

FRAMES = 20


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world()


@pytest.fixture(scope="module")
def images(world: MovingWorld) -> list[np.ndarray]:
    """The images of the first frames, with the same tissue in all."""
    return drawn(world, FRAMES)


@pytest.fixture(scope="module")
def tissue(world: MovingWorld, images: list[np.ndarray]) -> np.ndarray:
    """An image without the instrument."""
    seen = np.stack([np.where(mask[..., None], 0, image) for mask, image in zip(world.masks, images, strict=False)])
    return np.asarray(np.where((mean := seen.max(axis=0)).any(axis=2, keepdims=True), mean, (50, 60, 130)), np.uint8)


@pytest.fixture(scope="module")
def first(world: MovingWorld) -> Result:
    """The first frame solved by itself, by its mask."""
    return estimate(world.masks[0], world.camera, world.readings[0], world.body)


def follow(world: MovingWorld, tracker: Tracker, frames: range, images: list[np.ndarray]) -> list[TrackResult]:
    """Follow frames by their images."""
    results = []
    for k in frames:
        tracker.add_readings(world.time(k), world.readings[k])
        results.append(tracker.step(world.time(k), image=images[k]))
    return results


def started(world: MovingWorld, first: Result, image: np.ndarray, **options: object) -> Tracker:
    """Give a tracker that has the first frame's result and image."""
    tracker = Tracker(world.camera, world.body, lag=0.0, **options)  # type: ignore[arg-type]
    tracker.add_readings(world.time(0), world.readings[0])
    tracker.start(world.time(0), first, image=image)
    return tracker


@pytest.fixture(scope="module")
def results(world: MovingWorld, first: Result, images: list[np.ndarray]) -> list[TrackResult]:
    """The results of the frames after the first one."""
    return follow(world, started(world, first, images[0]), range(1, FRAMES), images)


def errors_mm(world: MovingWorld, results: list[TrackResult], begin: int = 1) -> np.ndarray:
    return np.array([world.error_mm(begin + k, result) for k, result in enumerate(results)])


def test_tips_are_followed_by_images_alone(world: MovingWorld, results: list[TrackResult]) -> None:
    errors = errors_mm(world, results)
    assert np.median(errors) < 1.2  # the images are small: they tell little of the depth
    assert errors.max() < 2.5
    assert {result.status for result in results} == {"doubtful"}  # until keyframes tell the base


def test_keyframes_have_masks_that_are_found_in_images(
    world: MovingWorld, first: Result, images: list[np.ndarray]
) -> None:
    tracker = started(world, first, images[0])
    follow(world, tracker, range(1, FRAMES), images)
    keyframes = tracker.problem().keyframes
    assert len(keyframes) >= 4
    for keyframe in keyframes:
        (view,) = keyframe.data(Rig.of(world.camera)).views
        true = world.masks[round(30 * keyframe.time)]
        assert (view.mask & true).sum() > 0.9 * (view.mask | true).sum()


def test_instrument_that_is_gone_is_never_ok_and_is_found_again(
    world: MovingWorld, first: Result, images: list[np.ndarray], tissue: np.ndarray
) -> None:
    gone = range(8, 14)
    shown = [tissue if k in gone else image for k, image in enumerate(images)]
    # frames that are alike are frozen, which is another reason for doubt
    shown = [np.roll(image, k % 2, axis=1) if k in gone else image for k, image in enumerate(shown)]
    followed = follow(world, started(world, first, images[0]), range(1, FRAMES), shown)
    assert {followed[k - 1].status for k in gone} == {"lost"}
    assert world.error_mm(FRAMES - 1, followed[-1]) < 2.5


def test_masks_and_images_may_alternate(world: MovingWorld, first: Result, images: list[np.ndarray]) -> None:
    tracker = started(world, first, images[0])
    results = []
    for k in range(1, 14):
        tracker.add_readings(world.time(k), world.readings[k])
        results.append(tracker.step(world.time(k), mask=world.masks[k] if k % 2 else None, image=images[k]))
    assert errors_mm(world, results).max() < 2
