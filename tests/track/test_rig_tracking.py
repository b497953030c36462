"""Following with both eyes: closer than with one, with views that are missing, hidden or frozen, and wrong use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers.moving_worlds import SMALL, MovingWorld, Truth, exact_mask, moving_world
from helpers.transforms import transform

from dvrk_cmaes import Camera, InputError, Result, Rig, Tracker, TrackResult, estimate

FRAMES = 24
RIGHT = Camera(400, 300, 620, 640, 190, 152)
RIGHT_FROM_LEFT = transform(np.eye(3), [-0.0053, 0.0002, 0.0])
RIG = Rig.stereo(SMALL, RIGHT, RIGHT_FROM_LEFT)
Masks = dict[str, np.ndarray | None]


@dataclass(frozen=True, eq=False)
class StereoWorld:
    """A moving arm seen by two eyes of different cameras, and the result of the first frame."""

    left: MovingWorld
    right: list[np.ndarray]
    first: Result

    def tracker(self, rig: Rig | Camera = RIG) -> Tracker:
        """Give a tracker that has the first frame's result."""
        tracker = Tracker(rig, self.left.body, lag=0.0)
        tracker.add_readings(0.0, self.left.readings[0])
        tracker.start(0.0, self.first)
        return tracker

    def masks(self, frame: int) -> Masks:
        return {"left": self.left.masks[frame], "right": self.right[frame]}

    def follow(
        self, masks: Callable[[int], object] | None = None, *, tracker: Tracker | None = None, end: int = FRAMES
    ) -> list[TrackResult]:
        """Follow the frames from the second to before ``end``, with other masks where they are given."""
        given = self.masks if masks is None else masks
        return self.left.follow(tracker or self.tracker(), frames=range(1, end), mask=given)  # type: ignore[arg-type]

    def errors_mm(self, results: list[TrackResult]) -> np.ndarray:
        return np.array([self.left.error_mm(1 + k, result) for k, result in enumerate(results)])


@pytest.fixture(scope="module")
def world() -> StereoWorld:
    left = moving_world(FRAMES)

    def seen(truth: Truth) -> np.ndarray:
        moved = replace(truth, camera_from_root=RIGHT_FROM_LEFT @ truth.camera_from_root)
        return exact_mask(RIGHT, moved)

    first = estimate(left.masks[0], left.camera, left.readings[0], left.body)
    return StereoWorld(left, [seen(truth) for truth in left.truths], first)


def test_both_eyes_determine_more_than_one(world: StereoWorld) -> None:
    both = world.follow()
    one = world.follow(lambda k: world.left.masks[k], tracker=world.tracker(SMALL))
    assert np.median(world.errors_mm(both)) < 0.5
    stated = [np.median([result.tip_std_mm for result in results]) for results in (both, one)]  # type: ignore[misc]
    assert stated[0] < 0.97 * stated[1]


def test_rig_of_one_view_answers_as_its_camera(world: StereoWorld) -> None:
    by_rig = world.follow(lambda k: {"left": world.left.masks[k]}, tracker=world.tracker(Rig.of_camera(SMALL)))
    by_camera = world.follow(lambda k: world.left.masks[k], tracker=world.tracker(SMALL))
    for one, other in zip(by_rig, by_camera, strict=True):
        assert one.to_dict("a") | {"seconds": 0} == other.to_dict("a") | {"seconds": 0}


def test_view_that_is_missing_now_and_then_does_not_matter(world: StereoWorld) -> None:
    def masks(k: int) -> Masks:
        return {"left": None if k % 3 == 0 else world.left.masks[k], "right": None if k % 3 == 1 else world.right[k]}

    results = world.follow(masks)
    assert "lost" not in {result.status for result in results}
    assert world.errors_mm(results).max() < 1.0


def test_frozen_eye_is_left_out(world: StereoWorld) -> None:
    results = world.follow(lambda k: {"left": world.left.masks[min(k, 10)], "right": world.right[k]})
    assert world.errors_mm(results).max() < 1.5


def test_views_that_contradict_each_other_are_not_ok(world: StereoWorld) -> None:
    def elsewhere(k: int) -> np.ndarray:
        mask = np.zeros_like(world.right[0])
        mask[20 + k : 120, 20:200] = True
        return mask

    results = world.follow(lambda k: {**world.masks(k), "right": elsewhere(k)} if k > 4 else world.masks(k), end=9)
    assert "ok" not in {result.status for result in results[4:]}
    assert world.errors_mm(results).max() < 1.5


def test_first_frame_is_solved_in_both_views(world: StereoWorld) -> None:
    tracker = Tracker(RIG, world.left.body, lag=0.0)
    tracker.add_readings(0.0, world.left.readings[0])
    result = tracker.step(0.0, world.masks(0))
    assert result.searched
    assert world.left.error_mm(0, result) < 0.5


@pytest.mark.parametrize(
    ("mask", "expected"),
    [
        (lambda w: w.left.masks[1], "mask: expected one by view (left, right), got 1"),
        (lambda w: [w.left.masks[1]], "mask: expected one by view (left, right), got 1"),
        (lambda w: {"middle": w.left.masks[1]}, "mask: expected views "),
        (lambda w: {"right": w.left.masks[1]}, "mask: expected 400 x 300 pixels as the camera has"),
    ],
)
def test_masks_that_are_not_those_of_the_views_are_refused(
    world: StereoWorld, mask: Callable[[StereoWorld], object], expected: str
) -> None:
    with pytest.raises(InputError) as caught:
        world.tracker().step(0.1, mask(world))  # type: ignore[arg-type]
    assert str(caught.value).startswith(expected)
