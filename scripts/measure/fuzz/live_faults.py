"""The loop of `live` fed with faults of times and messages, one after the other: lines, recovery, and memory.

An arm moves to and fro, as in `measure.fuzz.tracker`; masks are sent as fast as they are followed, with times 30 a
second. After each fault follow good images: within two seconds of them there must be a pose again, and a fault
must cost one line at most. Faults are of 30 kinds, in turns; between two of them lie a given number of good images.
"""

from __future__ import annotations

import base64
import sys
import threading
import time as clock
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np
import psutil

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.live.arm import LiveArm
from dvrk_cmaes.live.connection import Connection
from dvrk_cmaes.live.inputs import EyeTopics, Inputs, InputTopics
from dvrk_cmaes.live.loop import LiveLoop
from dvrk_cmaes.live.outputs import Outputs
from dvrk_cmaes.live.repeated_lines import RepeatedLines
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.synth.moving_arm import FRAMES_A_SECOND
from dvrk_cmaes.track import Tracker
from measure.fuzz.tracker import CAMERA, SETTINGS, World

MASK, JOINTS = "/left/mask", "/PSM1/measured_js"
TOPICS: Final = InputTopics({"left": EyeTopics.of("/left/image", masks={"PSM1": MASK})}, {"PSM1": (JOINTS,)})
BEGIN: Final = 1_795_000_000.0  # s
BACK_WITHIN: Final = round(2 * FRAMES_A_SECOND)  # good images
_FOLLOWED: Final = ("ok", "doubtful")
_SHOWN: Final = 10  # violations
_JUDGED: Final = 60.0  # s, within which an image must have been judged

Fields = dict[str, Any]


@dataclass
class LiveReport:
    """What came of the faults: lines, good images until there was a pose again, and memory in MB."""

    faults: Counter[str] = field(default_factory=Counter)
    images: int = 0
    lines: int = 0
    restarts: int = 0
    back: list[int] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)
    megabytes: list[float] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def growth(self) -> float:
        """Relative growth of the memory from a tenth of the faults to the end; largest of each part's last tenth."""
        part = max(len(self.megabytes) // 10, 1)
        early, late = max(self.megabytes[part : 2 * part] or self.megabytes), max(self.megabytes[-part:])
        return late / early - 1

    def __str__(self) -> str:
        back = sorted(self.back) or [0]
        lines = [
            f"live: {sum(self.faults.values())} faults of {len(self.faults)} kinds, {self.images} images, "
            f"{self.lines} lines, following began anew {self.restarts} times, {len(self.violations)} violations",
            f"  a pose again after {back[len(back) // 2]} good images (median), {back[-1]} (most)",
            f"  memory: {self.megabytes[0]:.1f} MB at first, {self.megabytes[-1]:.1f} MB now, grown by "
            f"{100 * self.growth:.1f} % since a tenth of the faults",
            f"  {self.seconds:.0f} s",
        ]
        return "\n".join([*lines, *self.violations[:_SHOWN]])


def fuzz_live(faults: int, between: int, *, only: Sequence[str] = ()) -> LiveReport:
    """Feed the loop with a number of faults, with at least ``between`` good images after each.

    They are of all kinds in turns, or of those named in ``only``.
    """
    report, began = LiveReport(), clock.monotonic()
    feed = _Feed(World.made(), report)
    try:
        feed.good(BACK_WITHIN)
        kinds = feed.kinds()
        for number in range(faults):
            name = (*only, *(() if only else kinds))[number % len(only or kinds)]
            feed.fault(name, kinds[name], between)
    finally:
        feed.stop()
    report.restarts, report.seconds = feed.loop.counts.restarts, clock.monotonic() - began
    return report


class _Lines:
    """Takes the lines for the user; each fault begins without those of earlier ones."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self.said.clear()
        self._repeated = RepeatedLines(self.said.append)

    def __call__(self, line: str) -> None:
        self._repeated(line)


class _Follower:
    """A tracker whose steps may be told to fail, and which keeps its last result."""

    def __init__(self, world: World, feed: _Feed) -> None:
        self._tracker, self._feed = Tracker(CAMERA, world.body, config=SETTINGS, lag=0.0), feed

    state = ""

    def add_readings(self, time: float, joints: Mapping[str, float]) -> None:
        self._tracker.add_readings(time, joints)

    def step(self, time: float, mask: Any = None, image: Any = None, ignore: Any = None) -> TrackResult:
        if self._feed.errors:
            raise self._feed.errors.pop()
        result = self._tracker.step(time, mask, image, ignore)
        self._feed.status = result.status
        return result

    def after_step(self, time: float) -> None:
        """Nothing is due."""


class _Feed:
    """Sends messages to a loop on another thread, image by image."""

    def __init__(self, world: World, report: LiveReport) -> None:
        self.status, self.errors = "", list[Exception]()
        self._world, self._report = world, report
        self._wire, self._lines, self._stop = Connection("wire"), _Lines(), threading.Event()
        self._frame, self._ahead = 0, 0.0  # s, by which the clocks of the messages were set
        inputs = Inputs(TOPICS, self._lines, longest_silence=1e6, now=lambda: self._frame / FRAMES_A_SECOND)
        inputs.subscribe(self._wire)
        outputs = Outputs(self._wire, FrameNames())
        arm = LiveArm("PSM1", lambda rig: _Follower(world, self), outputs, self._lines, inputs.now)
        self.loop = LiveLoop([arm], inputs, self._lines, rig=Rig.of_camera(CAMERA))
        self._lines.forget()
        self._thread = threading.Thread(target=self.loop.run, args=(self._stop,), daemon=True)
        self._thread.start()
        self._process = psutil.Process()

    def stop(self) -> None:
        """End the loop."""
        self._stop.set()
        self._thread.join(_JUDGED)

    def good(self, count: int, *, again: bool = False) -> None:
        """Send good images; with ``again``, a violation unless there is a pose within `BACK_WITHIN` of them."""
        since: int | None = None
        for number in range(1, count + 1):
            self.status = ""
            self._send()
            if since is None and self.status in _FOLLOWED:
                since = number
        if again and (since is None or since > BACK_WITHIN):
            self._violation(f"no pose within {BACK_WITHIN} good images")
        elif again and since is not None:
            self._report.back.append(since)

    def fault(self, name: str, make: Callable[[], None], between: int) -> None:
        """Make a fault, send good images, and look at the lines."""
        self._report.faults[name] += 1
        self._name = name
        self._lines.forget()
        make()
        self.good(max(between, BACK_WITHIN), again=True)
        self._report.lines += len(self._lines.said)
        if len(self._lines.said) > 1:
            self._violation(f"{len(self._lines.said)} lines: {' | '.join(self._lines.said[:3])}")
        self._report.megabytes.append(self._process.memory_info().rss / 1e6)
        print(f"{sum(self._report.faults.values())} {name}: {self._lines.said}", file=sys.stderr, flush=True)

    def _violation(self, what: str) -> None:
        self._report.violations.append(f"  fault {sum(self._report.faults.values())}, {self._name}: {what}")

    def kinds(self) -> dict[str, Callable[[], None]]:
        """Return the kinds of faults by name."""
        jumps = {"11 s": 11.0, "an hour": 3600.0, "a year": 31_536_000.0}
        kinds: dict[str, Callable[[], None]] = {}
        for text, jump in jumps.items():
            for way, sign in (("ahead", 1), ("back", -1)):
                kinds[f"one image {text} {way}"] = partial(self._send, image_ahead=sign * jump)
                kinds[f"clock set {text} {way}"] = partial(self._set_clock, sign * jump)
        kinds |= {
            "clock set half a second back": lambda: self._set_clock(-0.5),
            "images of the same time": lambda: self._same_time(20),
            "time of zero": lambda: self._several(5, image_at=0.0),
            "negative time": lambda: self._several(5, image_at=-5.0),
            "no time": lambda: self._several(5, without=("header",)),
            "nanoseconds beyond a second": lambda: self._several(5, header={"stamp": {"sec": 1, "nanosec": 10**10}}),
            "readings an hour ahead": lambda: self._several(30, joints_ahead=3600.0),
            "no readings": lambda: self._several(30, read=False),
            "readings that are no numbers": lambda: self._several(5, joints={"position": ["a"]}),
            "readings of other joints": lambda: self._several(5, joints={"name": ["elbow"], "position": [0.0]}),
            "fewer readings than names": lambda: self._several(5, joints={"name": ["jaw", "yaw"], "position": [0.1]}),
            "data too short": lambda: self._several(5, data="AAAA"),
            "data that are no base64": lambda: self._several(5, data="???"),
            "size beyond the data": lambda: self._several(5, width=10**9, step=10**9),
            "unknown encoding": lambda: self._several(5, encoding="cmyk"),
            "mask of another size": lambda: self._several(5, shape=(60, 80)),
            "masks without instrument": lambda: self._several(15, filled=False),
            "masks full of instrument": lambda: self._several(15, filled=True),
            "a step that fails": lambda: self._fail(1, np.linalg.LinAlgError("singular")),
            "steps that fail": lambda: self._fail(4, ValueError("a\nb")),
        }
        return kinds

    def _set_clock(self, by: float) -> None:
        self._ahead += by

    def _several(self, count: int, **how: Any) -> None:
        for _ in range(count):
            self._send(**how)

    def _same_time(self, count: int) -> None:
        at = self._time()
        self._several(count, image_at=at)

    def _fail(self, count: int, error: Exception) -> None:
        self.errors += [error] * count
        self._several(count)

    def _time(self) -> float:
        return BEGIN + self._frame / FRAMES_A_SECOND + self._ahead

    def _send(
        self,
        *,
        image_ahead: float = 0.0,
        image_at: float | None = None,
        joints_ahead: float = 0.0,
        read: bool = True,
        joints: Fields | None = None,
        shape: tuple[int, int] | None = None,
        filled: bool | None = None,
        without: tuple[str, ...] = (),
        **changed: Any,
    ) -> None:
        """Send the readings and the mask of the next frame, and wait until it was judged or cannot be read."""
        self._frame += 1
        self._report.images += 1
        number, time = self._world.frame(self._frame), self._time()
        if read:
            readings = self._world.readings[number]
            own = {"name": list(readings), "position": list(readings.values())} | (joints or {})
            self._wire.receivers[JOINTS]({"header": _header(time + joints_ahead), **own})
        mask = self._world.masks[number]
        if filled is not None:
            mask = np.full_like(mask, filled)
        if shape is not None:
            mask = mask[: shape[0], : shape[1]]
        fields = _image(mask, time + image_ahead if image_at is None else image_at) | changed
        counts, before = self.loop.counts, self._judged()
        said = len(self._lines.said)
        self._wire.receivers[MASK]({name: value for name, value in fields.items() if name not in without})
        if without or "header" in changed:
            return  # a message without a valid time is no frame
        end = clock.monotonic() + _JUDGED
        while self._judged() == before and clock.monotonic() < end:
            clock.sleep(0.0005)
        if self._judged() == before:
            self._violation(f"not judged within {_JUDGED:g} s, {len(self._lines.said) - said} lines; {counts}")

    def _judged(self) -> tuple[int, int]:
        return self.loop.counts.followed, self.loop.counts.refused


def _header(time: float) -> Fields:
    nanoseconds = round(time * 1e9)
    return {"stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}}


def _image(mask: Any, time: float) -> Fields:
    height, width = mask.shape
    data = base64.b64encode((mask * np.uint8(255)).tobytes()).decode()
    return {
        "header": _header(time),
        "width": width,
        "height": height,
        "step": width,
        "encoding": "mono8",
        "data": data,
    }
