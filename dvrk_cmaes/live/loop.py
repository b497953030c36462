"""The loop: the newest frame and the readings before it go to a tracker, and its result is published.

No message ends it. A frame whose time is wrong is left out; where a clock was set, or several steps in a row have
failed, a new tracker begins. While there is no pose, /diagnostics says once a second why.
"""

from __future__ import annotations

import time as clock
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.live.inputs import Inputs, LiveFrame
from dvrk_cmaes.live.outputs import Outputs, StepResult
from dvrk_cmaes.live.stamps import LONGEST_GAP, ImageTimes

Pixels = NDArray[np.uint8]
Mask = NDArray[np.bool_]
DrawOverlay = Callable[[Pixels, StepResult], Pixels]

_WAIT: Final = 0.1  # s, for an image, before silence is looked for
_STATE_EVERY: Final = 1.0  # s without a result, after which the status says why
_MOST_FAILURES: Final = 3  # steps in a row that fail, after which a new tracker begins


class LiveTracker(Protocol):
    """Follows an instrument; times are in seconds."""

    def add_readings(self, time: float, joints: Mapping[str, float]) -> None:
        """Add the readings of one time: joints by name, rad (insertion: m)."""

    def step(self, time: float, mask: Mask | None = None, image: Pixels | None = None) -> StepResult:
        """Follow the instrument to the image of a later time."""


class Beside(Protocol):
    """Work that goes on beside the steps."""

    @property
    def state(self) -> str:
        """How far it is, in words."""

    def before_step(self) -> None:
        """Give the tracker what was found."""

    def after_step(self) -> None:
        """Begin what is due."""


@dataclass
class LiveCounts:
    """Frames followed, results published, frames and readings left out, and how often following began anew."""

    followed: int = 0
    published: int = 0
    refused: int = 0
    restarts: int = 0


class LiveLoop:
    """Runs a tracker on what is received.

    Parameters
    ----------
    make_tracker
        Makes a tracker, which follows the instrument. It is called from the thread of ``run`` only.
    inputs, outputs
        Where images and readings come from, and where results go.
    report
        Takes lines for the user.
    draw
        Draws a result over its image; None to publish no overlay.
    beside
        Is called before and after each step; its state is published.
    longest_silence
        Time without a message after which a topic is reported, s.
    """

    def __init__(
        self,
        make_tracker: Callable[[], LiveTracker],
        inputs: Inputs,
        outputs: Outputs,
        report: Report,
        *,
        draw: DrawOverlay | None = None,
        beside: Beside | None = None,
        longest_silence: float = 1.0,
    ) -> None:
        self.counts = LiveCounts()
        self._make_tracker = make_tracker
        self._tracker = make_tracker()
        self._inputs = inputs
        self._state = PresentState(outputs)
        self._outputs = outputs
        self._report = report
        self._draw = draw
        self._beside = beside
        self._longest_silence = longest_silence
        self._times = ImageTimes()
        self._failures = 0

    def run(self, stop: Event) -> LiveCounts:
        """Follow until ``stop`` is set; returns the counts."""
        while not stop.is_set():
            frame = self._inputs.frames.take(_WAIT)
            received = clock.perf_counter()
            silent = self._inputs.report_silence(self._longest_silence)
            if frame is not None:
                self._take(frame, received, silent)
            self._state.publish_if_due(silent)
        return self.counts

    def _take(self, frame: LiveFrame, received: float, silent: tuple[str, ...]) -> None:
        """Follow a frame, or leave it out for one of the reasons of this module's description."""
        topic = frame.topics.image if frame.topics.mask is None else frame.topics.mask
        judged = self._times.judge(frame.time)
        if judged.line:
            self._report(f"{topic}: {judged.line}")
        if judged.restarts:
            self._restart()
        if not judged.used:
            self._leave_out(f"{topic}: {judged.status}")
            return
        try:
            self._follow(frame, received, silent)
            self._failures = 0
            self._times.follow(frame.time)
        except InputError as error:
            self._report(str(error))
            self._leave_out(str(error))
        except Exception as error:
            self._fail(error)

    def _leave_out(self, reason: str) -> None:
        """Count a frame that is left out."""
        self.counts.refused += 1
        self._state.set("image left out", reason)

    def _fail(self, error: Exception) -> None:
        """Leave out a frame whose step failed; after several in a row a new tracker begins."""
        if isinstance(error, MemoryError):
            reason = "out of memory"
        else:
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}"
            reason = f"internal error: {where}: {one_line(error)}"
        self._failures += 1
        if self._failures >= _MOST_FAILURES:
            self._restart()
        self._report(f"{reason}; the image is left out; after {_MOST_FAILURES} in a row following begins anew")
        self._leave_out(reason)

    def _restart(self) -> None:
        """Begin with a new tracker."""
        self._tracker, self._failures = self._make_tracker(), 0
        self.counts.restarts += 1

    def _follow(self, frame: LiveFrame, received: float, silent: tuple[str, ...]) -> None:
        """Give the readings and a frame to the tracker, and publish the result."""
        for readings in self._inputs.readings.take_all():
            ahead = (readings.time - frame.time) / NANOSECONDS
            try:
                if abs(ahead) > LONGEST_GAP:
                    raise InputError(f"{readings.topic}: readings {ahead:+z.1f} s from the images are left out")
                self._tracker.add_readings(readings.time / NANOSECONDS, readings.joints)
            except InputError as error:
                self.counts.refused += 1
                self._report(str(error))
        mask = frame.mask()
        pixels = frame.pixels(grey=mask is not None and self._draw is None)  # its colours are needed by nobody then
        if self._beside is not None:
            self._beside.before_step()
        result = self._tracker.step(frame.time / NANOSECONDS, mask=mask, image=pixels)
        self.counts.followed += 1
        overlay = None if self._draw is None or pixels is None else self._draw(pixels, result)
        age = clock.perf_counter() - received
        state = "" if self._beside is None else self._beside.state
        self.counts.published += self._outputs.publish(
            frame.time, result, ros1=frame.ros1, age=age, silent=silent, overlay=overlay, calibration=state
        )
        self._state.has_result(ros1=frame.ros1)
        if self._beside is not None:
            self._beside.after_step()


class PresentState:
    """Publishes why there is no result now, once a second, while there is none."""

    def __init__(self, outputs: Outputs, state: str = "waiting for images") -> None:
        self._outputs = outputs
        self._waiting = self._state = state
        self._reason = ""
        self._ros1 = False
        self._published = clock.monotonic()

    def set(self, state: str, reason: str = "") -> None:
        """Set what is published."""
        self._state, self._reason = state, reason

    def has_result(self, *, ros1: bool) -> None:
        """Note that a result was published, with times as in ROS 1 or not."""
        self._published, self._ros1 = clock.monotonic(), ros1
        self.set(self._waiting)

    def publish_if_due(self, silent: Sequence[str] = ()) -> None:
        """Publish the state if nothing was published for a second."""
        if clock.monotonic() - self._published >= _STATE_EVERY:
            self._published = clock.monotonic()
            self._outputs.publish_state(clock.time_ns(), self._state, self._reason, ros1=self._ros1, silent=silent)
