"""A moving arm in memory, with exact masks and readings, for tests of following."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from dvrk_cmaes import Body, Camera, Tracker, TrackResult, prepare
from dvrk_cmaes.synth.images import draw_image
from dvrk_cmaes.synth.moving_arm import FRAMES_A_SECOND, MotionLevel, moving_arm, read_moving
from dvrk_cmaes.synth.scene import exact_mask
from dvrk_cmaes.synth.truth import Truth
from helpers.transforms import moved

SMALL = Camera(320, 240, 513, 513, 161, 119)
OFFSETS_ONLY = MotionLevel(1.5, 0.0, 4.0, 0.0, 0.0, 0.0, False, False)
"""Readings with a constant offset of each cable-driven joint, and images in time."""


@dataclass(frozen=True, eq=False)
class MovingWorld:
    """Frames of a moving arm: truths, exact masks, readings by frame, and the arm's true base (4, 4)."""

    body: Body
    camera: Camera
    base: np.ndarray
    truths: list[Truth]
    masks: list[np.ndarray]
    readings: list[dict[str, float]]

    def time(self, frame: int) -> float:
        """Time of a frame, s."""
        return frame / FRAMES_A_SECOND

    def follow(
        self,
        tracker: Tracker,
        *,
        frames: range | None = None,
        mask: Callable[[int], np.ndarray | None] | None = None,
        readings: Callable[[int], dict[str, float]] | None = None,
    ) -> list[TrackResult]:
        """Follow some frames, or all, with other masks or readings where they are given."""
        results = []
        for k in range(len(self.truths)) if frames is None else frames:
            read = self.readings[k] if readings is None else readings(k)
            if read:
                tracker.add_readings(self.time(k), read)
            results.append(tracker.step(self.time(k), self.masks[k] if mask is None else mask(k)))
        return results

    def error_mm(self, frame: int, result: TrackResult) -> float:
        """Mean distance of the tips from their true places, mm."""
        assert result.tips is not None
        return 1e3 * float(np.linalg.norm(result.tips - self.truths[frame].tips, axis=1).mean())


@cache
def moving_world(
    frames: int = 40, seed: int = 3, level: MotionLevel = OFFSETS_ONLY, right: float = 0.0, shown: int | None = None
) -> MovingWorld:
    """Make a moving arm with the bundled instrument, the whole moved to the right by some metres.

    Masks are drawn of the first frames ``shown``, or of all.
    """
    body = prepare("lnd")
    rng = np.random.default_rng(seed)
    base, truths, _ = moving_arm(body, SMALL, rng, frames, level)
    aside = moved(np.eye(4), [right, 0.0, 0.0, 0.0, 0.0, 0.0])
    base = aside @ base
    truths = [replace(truth, camera_from_root=aside @ truth.camera_from_root) for truth in truths]
    paths = read_moving(truths, rng, level)
    readings = [{name: float(path[k]) for name, path in paths.items()} for k in range(frames)]
    return MovingWorld(body, SMALL, base, truths, [exact_mask(SMALL, truth) for truth in truths[:shown]], readings)


def drawn(world: MovingWorld, frames: int) -> list[np.ndarray]:
    """Draw images of the first frames, before tissue."""
    return [draw_image(world.camera, truth, np.random.default_rng(5)) for truth in world.truths[:frames]]
