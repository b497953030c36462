"""Progress of a batch on stderr, as a bar on a terminal and as lines otherwise."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from dvrk_cmaes.cli.terminal import frames_text
from dvrk_cmaes.results.result import Status
from dvrk_cmaes.runs.batch import BatchProgress
from dvrk_cmaes.runs.worker import FrameOutcome

_LINE_INTERVAL: Final = 30.0  # s


class _Reporter(BatchProgress):
    """Frames done, rate, remaining time, numbers of doubtful and failed frames: in a bar, or in lines at intervals."""

    def __init__(self, bar: Progress | None = None) -> None:
        self._bar = bar
        self._done = 0
        self._counts: Counter[str] = Counter()

    def on_start(self, todo: int, kept: Sequence[Status]) -> None:
        self._todo, self._started = todo, time.monotonic()
        self._last_line = self._started
        self._counts.update(kept)
        if kept:
            print(f"dvrk-cmaes: results are there of {frames_text(len(kept))}, {todo} are to be done", file=sys.stderr)
        if self._bar is not None:
            self._task = self._bar.add_task("frames", total=todo, figures="starting")

    def on_note(self, text: str) -> None:
        print(f"dvrk-cmaes: {text}", file=sys.stderr)

    def on_frame(self, outcome: FrameOutcome) -> None:
        self._done += 1
        self._counts[outcome.result.status] += 1
        now = time.monotonic()
        rate = self._done / max(now - self._started, 1e-9)
        counts = f"{self._counts['doubtful']} doubtful, {self._counts['failed']} failed"
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, figures=f"{rate:.2f} a second, {counts}")
        elif now - self._last_line >= _LINE_INTERVAL:
            self._last_line = now
            left = timedelta(seconds=round((self._todo - self._done) / rate))
            figures = f"{rate:.2f} a second, {left} left, {counts}"
            print(f"dvrk-cmaes: {self._done} of {self._todo} frames, {figures}", file=sys.stderr, flush=True)


@contextmanager
def progress() -> Iterator[BatchProgress]:
    """Give a progress callback that reports a batch on stderr."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Reporter()
        return
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[figures]}"),
        console=console,
    ) as bar:
        yield _Reporter(bar)
