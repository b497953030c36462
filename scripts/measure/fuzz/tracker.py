"""A tracker fed with randomly damaged input for many steps: what it raises, whether it comes back, and its memory.

An arm moves to and fro. Stretches of good input, in which the instrument must be found again, follow stretches in which
masks, images, readings and times are damaged one by one or together. Damage is what can be told from a valid input:
readings that are wrong but possible are no part of it. The images are small and the searches short, so that many steps
can be made.
"""

from __future__ import annotations

import math
import random
import sys
import time as clock
import tomllib
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

import numpy as np
import psutil
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.toml_file import updated
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.synth.moving_arm import FRAMES_A_SECOND, MotionLevel, moving_arm, read_moving
from dvrk_cmaes.synth.truth import Truth, exact_mask
from dvrk_cmaes.track import Tracker
from measure.fuzz.families import QUICK

Mask = NDArray[np.bool_]

CAMERA: Final = Camera(160, 120, 256.5, 256.5, 80.5, 59.5)
SETTINGS: Final = updated(EstimateConfig(), tomllib.loads(QUICK), where="tracker.py")
FRAMES: Final = 60
DAMAGED, GOOD = (1, 60), (40, 80)  # steps of a stretch, least and most
LEAST_IOU: Final = 0.85  # of silhouette and mask, from which on the instrument counts as found again
TRUE_MM: Final = 3.0  # largest error of the tips of the true mode; images this small do not always tell it from others
_LEVEL: Final = MotionLevel(1.5, 0.0, 4.0, 0.0, 0.0, 0.0, False, False)
_VALUES: Final = (math.nan, math.inf, -math.inf, 1e308, -1e308, 1e6, 100.0, -7.0)
_SAMPLES: Final = 200  # steps between samples of the memory
_REPORTED: Final = 1000  # steps between reports
_SHOWN: Final = 10  # violations


@dataclass
class TrackerReport:
    """What came of the steps: counts, violations, images until the instrument was found again, and memory in MB.

    ``true_mode`` counts how often it was found in its true mode.
    """

    steps: int = 0
    refused: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)
    back: list[int] = field(default_factory=list)
    true_mode: int = 0
    megabytes: list[float] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def growth(self) -> float:
        """Relative growth of the memory from a tenth of the steps to the end; largest of each part's last tenth."""
        part = max(len(self.megabytes) // 10, 1)
        early, late = max(self.megabytes[part : 2 * part] or self.megabytes), max(self.megabytes[-part:])
        return late / early - 1

    def __str__(self) -> str:
        back = sorted(self.back)
        lines = [
            f"tracker: {self.steps} steps, {self.refused} inputs refused, {len(self.violations)} violations",
            f"  statuses: {', '.join(f'{name} {count}' for name, count in sorted(self.statuses.items()))}",
            f"  memory: {self.megabytes[min(1000 // _SAMPLES, len(self.megabytes) - 1)]:.1f} MB after 1,000 steps, "
            f"{self.megabytes[-1]:.1f} MB now, grown by {100 * self.growth:.1f} % since a tenth of the steps",
            f"  {self.seconds:.0f} s of processor time",
        ]
        if back:
            at95 = back[min(len(back) - 1, round(0.95 * len(back)))]
            lines.append(
                f"  found again {len(back)} times, after {back[len(back) // 2]} good images (median), {at95} (95 %), "
                f"{back[-1]} (most); {self.true_mode} times in its true mode"
            )
        return "\n".join([*lines, *self.violations[:_SHOWN]])


def fuzz_tracker(steps: int, seed: int) -> TrackerReport:
    """Run a tracker for a number of steps; the same seed gives the same input."""
    report, world, chance = TrackerReport(), World.made(), random.Random(seed)
    tracker = Tracker(CAMERA, world.body, config=SETTINGS, lag=0.0)
    feed, began = _Feed(world, tracker, report, chance), clock.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # NumPy's, of numbers that overflow, are violations too
        while report.steps < steps:
            feed.good(chance.randint(*GOOD), steps)
            feed.damaged(chance.randint(*DAMAGED), steps)
    report.seconds = clock.process_time() - began
    return report


@dataclass(frozen=True, eq=False)
class World:
    """Frames of an arm that moves: the truth of each, its exact mask, and the readings."""

    body: Body
    truths: list[Truth]
    masks: list[Mask]
    readings: list[dict[str, float]]

    @staticmethod
    @cache
    def made() -> World:
        """Return the world, which is always the same."""
        body, rng = prepare("lnd"), np.random.default_rng(3)
        _, truths, _ = moving_arm(body, CAMERA, rng, FRAMES, _LEVEL)
        paths = read_moving(truths, rng, _LEVEL)
        readings = [{name: float(path[k]) for name, path in paths.items()} for k in range(FRAMES)]
        return World(body, truths, [exact_mask(body, CAMERA, truth) for truth in truths], readings)

    def frame(self, step: int) -> int:
        """Return the frame of a step of the motion to and fro."""
        return FRAMES - 1 - abs(step % (2 * FRAMES - 2) - (FRAMES - 1))


class _Feed:
    """Gives good or damaged input to a tracker, step by step, and notes what comes of it."""

    def __init__(self, world: World, tracker: Tracker, report: TrackerReport, chance: random.Random) -> None:
        self._world, self._tracker, self._report, self._chance = world, tracker, report, chance
        self._time = 0.0
        self._process = psutil.Process()
        self._renderer = Renderer(world.body, CAMERA, threads=1)

    def good(self, count: int, most: int) -> None:
        """Give good input; a violation if the instrument is not found again within the stretch."""
        for since in range(count):
            if self._report.steps >= most:
                return
            frame = self._next()
            self._read(self._time, self._world.readings[frame])
            result = self._step(self._time, self._world.masks[frame])
            if result is not None and self._is_found(frame, result):
                self._report.back.append(since + 1)
                self._report.true_mode += self._is_true(frame, result)
                break
        else:
            self._violation(f"not found again within {count} good images")
            return
        for _ in range(self._chance.randint(0, 20)):
            if self._report.steps < most:
                frame = self._next()
                self._read(self._time, self._world.readings[frame])
                self._step(self._time, self._world.masks[frame])

    def damaged(self, count: int, most: int) -> None:
        """Give input that is damaged in one way or in several."""
        chance = self._chance
        parts = {part for part in ("mask", "image", "readings", "time") if chance.random() < 0.5}
        for _ in range(min(count, most - self._report.steps)):
            frame = self._next()
            mask, image, ignore = self._world.masks[frame], None, None
            readings, read_at, at = self._world.readings[frame], self._time, self._time
            if "mask" in parts:
                mask, ignore = self._odd_mask(mask), self._odd_mask(mask) if chance.random() < 0.2 else None
            if "image" in parts:
                image = self._odd_image()
            if "readings" in parts:
                readings, read_at = self._odd_readings(readings), self._odd_time(chance)
            if "time" in parts:
                at = self._odd_time(chance)
            self._read(read_at, readings)
            self._step(at, mask, image, ignore)

    def _next(self) -> int:
        """Go on by the time between two frames; returns the frame."""
        self._time += 1 / FRAMES_A_SECOND
        return self._world.frame(round(self._time * FRAMES_A_SECOND))

    def _odd_time(self, chance: random.Random) -> float:
        """Return a time that is not valid, or not in order; it never lies beyond the times that follow."""
        return self._time - chance.choice((math.nan, math.inf, -math.inf, 0.0, 0.0, 0.001, 0.033, 0.1, 5.0, 1e9))

    def _odd_mask(self, mask: Mask) -> Any:
        height, width = mask.shape
        rng = np.random.default_rng(self._chance.getrandbits(32))
        match self._chance.randrange(8):
            case 0:
                return None
            case 1:
                return np.zeros_like(mask)
            case 2:
                return np.ones_like(mask)
            case 3:
                return rng.random(mask.shape) < self._chance.random()
            case 4:
                return np.zeros((self._chance.randrange(height), width), dtype=bool)
            case 5:
                return mask ^ (rng.random(mask.shape) < 0.05)
            case 6:
                lines = np.zeros_like(mask)
                lines[:, self._chance.randrange(width)] = True
                return lines
        specks = np.zeros_like(mask)
        specks.ravel()[rng.integers(0, specks.size, 3)] = True
        return specks

    def _odd_image(self) -> Any:
        height, width = CAMERA.height, CAMERA.width
        match self._chance.randrange(4):
            case 0:
                return None
            case 1:
                return np.zeros((height, width, 3), np.uint8)
            case 2:
                return np.full((height, width, 3), 255, np.uint8)
        return np.zeros((self._chance.randrange(1, 2 * height), width, 3), np.uint8)

    def _odd_readings(self, readings: dict[str, float]) -> dict[str, float]:
        odd = dict(readings)
        for name in readings:
            match self._chance.randrange(5):
                case 0:
                    odd[name] = self._chance.choice(_VALUES)
                case 1:
                    del odd[name]
        if self._chance.random() < 0.1:
            odd[self._chance.choice(("elbow", "", "JAW", "\ud800"))] = 0.0
        return odd

    def _read(self, time: float, readings: dict[str, float]) -> None:
        try:
            self._tracker.add_readings(time, readings)
        except InputError as error:
            self._refused(error)
        except Exception:  # every other one is a violation
            self._violation(traceback.format_exc(limit=-2))

    def _step(self, time: float, mask: Any, image: Any = None, ignore: Any = None) -> TrackResult | None:
        self._report.steps += 1
        if self._report.steps % _SAMPLES == 0 or not self._report.megabytes:
            self._report.megabytes.append(self._process.memory_info().rss / 1e6)
        if self._report.steps % _REPORTED == 0:
            print(self._report, file=sys.stderr, flush=True)
        try:
            result = self._tracker.step(time, mask, image, ignore)
        except InputError as error:
            self._refused(error)
            return None
        except Exception:  # every other one is a violation
            self._violation(traceback.format_exc(limit=-2))
            return None
        self._report.statuses[result.status] += 1
        if result.camera_from_root is not None and not np.isfinite(result.camera_from_root).all():
            self._violation("a pose that is not finite")
        return result

    def _is_found(self, frame: int, result: TrackResult) -> bool:
        """Whether a result has a status other than lost, and a pose whose silhouette is the mask."""
        if result.status == "lost" or result.camera_from_root is None:
            return False
        joints = np.array([list(result.joints.values())])
        seen = self._renderer.masks(result.camera_from_root[None], joints)[0]
        mask = self._world.masks[frame]
        return int((seen & mask).sum()) >= LEAST_IOU * int((seen | mask).sum())

    def _is_true(self, frame: int, result: TrackResult) -> bool:
        """Whether a result has the tips where they truly are."""
        if result.tips is None:
            return False
        away = np.linalg.norm(np.asarray(result.tips) - self._world.truths[frame].tips, axis=1).mean()
        return float(1e3 * away) < TRUE_MM

    def _refused(self, error: InputError) -> None:
        self._report.refused += 1
        if len(str(error).splitlines()) != 1:
            self._violation(f"a message of several lines: {error}")

    def _violation(self, what: str) -> None:
        self._report.violations.append(f"  step {self._report.steps}: {what.strip()}")
