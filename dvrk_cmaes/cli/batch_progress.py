"""How a batch gets on, for people: a bar where stderr is a terminal, else a line now and then; and Ctrl-C."""

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

from dvrk_cmaes.cli.terminal import counted, warn
from dvrk_cmaes.results.result import Status
from dvrk_cmaes.runs.batch import Watcher
from dvrk_cmaes.runs.worker import FrameOutcome

_EVERY: Final = 30.0  # seconds between lines where there is no terminal


class _Lines(Watcher):
    """Lines for a log: how many are done, the rate, what remains, how many are doubtful and failed."""

    def __init__(self) -> None:
        self._todo = self._done = 0
        self._counts: Counter[str] = Counter()
        self._began = self._told = 0.0

    def begins(self, todo: int, kept: Sequence[Status]) -> None:
        self._todo, self._began = todo, time.monotonic()
        self._told = self._began
        self._counts.update(kept)
        if kept:
            print(f"dvrk-cmaes: results are there of {counted(len(kept))}, {todo} are to be done", file=sys.stderr)

    def done(self, outcome: FrameOutcome) -> None:
        self._done += 1
        self._counts[outcome.status] += 1
        if time.monotonic() - self._told >= _EVERY:
            self._told = time.monotonic()
            print(f"dvrk-cmaes: {self._done} of {self._todo} frames, {self.said()}", file=sys.stderr, flush=True)

    def said(self) -> str:
        """Rate, remaining time and counts."""
        rate = self.rate
        left = timedelta(seconds=round((self._todo - self._done) / rate))
        return f"{rate:.2f} a second, {left} left, {self._counts['doubtful']} doubtful, {self._counts['failed']} failed"

    @property
    def rate(self) -> float:
        """Frames a second since the beginning."""
        return self._done / max(time.monotonic() - self._began, 1e-9)


class _Bar(_Lines):
    """A bar that says the same."""

    def __init__(self, bar: Progress) -> None:
        super().__init__()
        self._bar = bar
        self._task: TaskID | None = None

    def begins(self, todo: int, kept: Sequence[Status]) -> None:
        super().begins(todo, kept)
        self._task = self._bar.add_task("frames", total=todo, said="starting")

    def done(self, outcome: FrameOutcome) -> None:
        self._done += 1
        self._counts[outcome.status] += 1
        assert self._task is not None
        counts = f"{self._counts['doubtful']} doubtful, {self._counts['failed']} failed"
        self._bar.update(self._task, completed=self._done, said=f"{self.rate:.2f} a second, {counts}")


@contextmanager
def progress() -> Iterator[Watcher]:
    """Watch a batch on stderr."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines()
        return
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[said]}"),
        console=console,
    ) as bar:
        yield _Bar(bar)


@contextmanager
def stopping_on_interrupt() -> Iterator[threading.Event]:
    """Give an event that the first Ctrl-C (or SIGTERM) sets; the second interrupts at once, as ever."""
    stop = threading.Event()

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
        warn("stopping: the frames that are running are finished and written first (Ctrl-C again: at once)")

    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
