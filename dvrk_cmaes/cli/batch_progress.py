"""Progress of a batch on stderr, as a bar on a terminal and as lines otherwise; handling of Ctrl-C."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from types import FrameType
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from dvrk_cmaes.cli.terminal import frames_text, warn
from dvrk_cmaes.results.result import Status
from dvrk_cmaes.runs.batch import BatchProgress
from dvrk_cmaes.runs.worker import FrameOutcome

_LINE_INTERVAL: Final = 30.0  # s


class _ProgressLines(BatchProgress):
    """Progress as lines at intervals: frames done, rate, remaining time, and numbers of doubtful and failed frames."""

    def __init__(self) -> None:
        self._todo = self._done = 0
        self._counts: Counter[str] = Counter()
        self._started = self._last_line = 0.0

    def on_start(self, todo: int, kept: Sequence[Status]) -> None:
        self._todo, self._started = todo, time.monotonic()
        self._last_line = self._started
        self._counts.update(kept)
        if kept:
            print(f"dvrk-cmaes: results are there of {frames_text(len(kept))}, {todo} are to be done", file=sys.stderr)

    def on_frame(self, outcome: FrameOutcome) -> None:
        self._done += 1
        self._counts[outcome.status] += 1
        if time.monotonic() - self._last_line >= _LINE_INTERVAL:
            self._last_line = time.monotonic()
            print(f"dvrk-cmaes: {self._done} of {self._todo} frames, {self.figures()}", file=sys.stderr, flush=True)

    def figures(self) -> str:
        """Return the rate, the remaining time and the numbers of doubtful and failed frames as text."""
        rate = self.rate
        left = timedelta(seconds=round((self._todo - self._done) / rate))
        return f"{rate:.2f} a second, {left} left, {self._counts['doubtful']} doubtful, {self._counts['failed']} failed"

    @property
    def rate(self) -> float:
        """Frames a second since the start."""
        return self._done / max(time.monotonic() - self._started, 1e-9)


class _ProgressBar(_ProgressLines):
    """The same figures in a progress bar."""

    def __init__(self, bar: Progress) -> None:
        super().__init__()
        self._bar = bar
        self._task: TaskID | None = None

    def on_start(self, todo: int, kept: Sequence[Status]) -> None:
        super().on_start(todo, kept)
        self._task = self._bar.add_task("frames", total=todo, figures="starting")

    def on_frame(self, outcome: FrameOutcome) -> None:
        self._done += 1
        self._counts[outcome.status] += 1
        assert self._task is not None
        counts = f"{self._counts['doubtful']} doubtful, {self._counts['failed']} failed"
        self._bar.update(self._task, completed=self._done, figures=f"{self.rate:.2f} a second, {counts}")


@contextmanager
def progress() -> Iterator[BatchProgress]:
    """Give a progress callback that reports a batch on stderr."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _ProgressLines()
        return
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[figures]}"),
        console=console,
    ) as bar:
        yield _ProgressBar(bar)


def _stopping() -> list[signal.Signals]:
    """Return the signals that stop a run; SIGHUP, of a terminal that is closed, only where nohup does not ignore it."""
    hang_up = [] if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else [signal.SIGHUP]
    return [signal.SIGINT, signal.SIGTERM, *hang_up]


@contextmanager
def stopping_on_interrupt() -> Iterator[threading.Event]:
    """Give an event that is set by the first Ctrl-C (or SIGTERM, SIGHUP); the second one raises KeyboardInterrupt.

    Signals are not handled outside the main thread.
    """
    stop = threading.Event()

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
        warn("stopping: the frames that are running are finished and written first (Ctrl-C again: at once)")

    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.signal(number, handle) for number in _stopping()}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
