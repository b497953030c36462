"""The loop: the newest frame and the readings before it go to a tracker, and its result is published."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import Event
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.live.inputs import Inputs, LiveFrame
from dvrk_cmaes.live.outputs import Outputs, StepResult

Pixels = NDArray[np.uint8]
Mask = NDArray[np.bool_]
DrawOverlay = Callable[[Pixels, StepResult], Pixels]

_WAIT: Final = 0.1  # s, for an image, before silence is looked for


class LiveTracker(Protocol):
    """Follows an instrument; times are in seconds."""

    def add_readings(self, time: float, joints: Mapping[str, float]) -> None:
        """Add the readings of one time: joints by name, rad (insertion: m)."""

    def step(self, time: float, mask: Mask | None = None, image: Pixels | None = None) -> StepResult:
        """Follow the instrument to the image of a later time."""


@dataclass
class LiveCounts:
    """Frames followed, results published, and frames and readings refused by the tracker or not valid."""

    followed: int = 0
    published: int = 0
    refused: int = 0


class LiveLoop:
    """Runs a tracker on what is received.

    Parameters
    ----------
    tracker
        Follows the instrument. It is called from the thread of ``run`` only.
    inputs, outputs
        Where images and readings come from, and where results go.
    report
        Takes lines for the user.
    draw
        Draws a result over its image; None to publish no overlay.
    longest_silence
        Time without a message after which a topic is reported, s.
    """

    def __init__(
        self,
        tracker: LiveTracker,
        inputs: Inputs,
        outputs: Outputs,
        report: Report,
        *,
        draw: DrawOverlay | None = None,
        longest_silence: float = 1.0,
    ) -> None:
        self.counts = LiveCounts()
        self._tracker = tracker
        self._inputs = inputs
        self._outputs = outputs
        self._report = report
        self._draw = draw
        self._longest_silence = longest_silence

    def run(self, stop: Event) -> LiveCounts:
        """Follow until ``stop`` is set; returns the counts."""
        while not stop.is_set():
            frame = self._inputs.frames.take(_WAIT)
            received = clock.perf_counter()
            silent = self._inputs.report_silence(self._longest_silence)
            if frame is None:
                continue
            try:
                self._follow(frame, received, silent)
            except InputError as error:
                self.counts.refused += 1
                self._report(str(error))
        return self.counts

    def _follow(self, frame: LiveFrame, received: float, silent: tuple[str, ...]) -> None:
        """Give the readings and a frame to the tracker, and publish the result."""
        for readings in self._inputs.readings.take_all():
            try:
                self._tracker.add_readings(readings.time / NANOSECONDS, readings.joints)
            except InputError as error:
                self.counts.refused += 1
                self._report(str(error))
        mask = frame.mask()
        pixels = frame.pixels(grey=mask is not None and self._draw is None)  # its colours are needed by nobody then
        result = self._tracker.step(frame.time / NANOSECONDS, mask=mask, image=pixels)
        self.counts.followed += 1
        overlay = None if self._draw is None or pixels is None else self._draw(pixels, result)
        age = clock.perf_counter() - received
        self.counts.published += self._outputs.publish(
            frame.time, result, ros1=frame.ros1, age=age, silent=silent, overlay=overlay
        )
