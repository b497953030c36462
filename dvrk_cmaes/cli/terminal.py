"""Text output on stdout and stderr, lines on stdout with styles if it is a terminal; exit codes and Ctrl-C."""

from __future__ import annotations

import contextlib
import functools
import io
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from types import FrameType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

if TYPE_CHECKING:
    from dvrk_cmaes.io.csv_file import Table
    from dvrk_cmaes.runs.pool import Workers

from dvrk_cmaes.io.short_text import escaped

T = TypeVar("T")

FAILED, DOUBTFUL, INTERRUPTED = 1, 3, 130  # exit codes; the last one as in shells: 128 + SIGINT
STATUS_STYLES = {"ok": "bold green", "doubtful": "bold yellow", "failed": "bold red"}

_STOPPING = "stopping: the frames that are running are finished and written first (Ctrl-C again: at once)"
_LINE_EVERY = 15.0  # s
_LONGEST = 900  # characters of an error message
_shown: list[Callable[[int, int, str], None]] = []  # the function of the bar that is shown


class Line(NamedTuple):
    """A line of output and its style on a terminal."""

    text: str
    style: str = ""


def prepare_streams() -> None:
    """Let stdout and stderr accept any file name; open the null device for one that is closed (``>&-``)."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (stays open until the program ends)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for file names that are not valid text


def discard_stdout() -> None:
    """Redirect stdout to the null device, so that unwritten output does not raise the same error again at exit."""
    with contextlib.suppress(OSError):  # stdout has no file descriptor, as in tests
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_error(message: str) -> None:
    """Print an error message as one line on stderr; if stderr cannot be written, only the exit code shows the error."""
    text = escaped(" ".join(message.split()))
    if len(text) > _LONGEST:
        text = f"{text[: _LONGEST // 2]} ... {text[-_LONGEST // 2 :]}"
    with contextlib.suppress(OSError):
        note(text)


def warn(message: str, arm: str = "") -> None:
    """Print a warning about a result on stderr."""
    note(f"warning: {arm}: {message}" if arm else f"warning: {message}")


def note(message: str) -> None:
    """Print information on stderr, for commands whose stdout contains only the result."""
    text = "\n".join(map(escaped, f"dvrk-cmaes: {message}".split("\n")))
    if not sys.stderr.isatty():
        print(text, file=sys.stderr)
        return
    from rich.text import Text

    error_console().print(Text(text))


@functools.cache
def error_console() -> Any:
    """Return rich's console of stderr, above whose progress bar lines are printed."""
    from rich.console import Console

    return Console(stderr=True)


def show(lines: Iterable[Line]) -> None:
    """Print lines on stdout, with their styles if it is a terminal."""
    if not sys.stdout.isatty():
        for line in lines:
            print(escaped(line.text))
        return
    from rich.console import Console
    from rich.text import Text

    console = Console()
    for line in lines:
        console.print(Text(escaped(line.text), style=line.style))


def table_lines(table: Table, most: int | None = None) -> Iterator[Line]:
    """Yield the lines of a table that has rows, the heading in bold; at most some of them."""
    if table.rows:
        head, *rows = table.lines()
        yield Line(head, "bold")
        yield from map(Line, rows[:most])
        if most is not None and len(rows) > most:
            yield Line(f"... and {len(rows) - most} more")


def answer(document: Any, lines: Iterable[Line], *, json: bool) -> None:
    """Print a document as JSON, or else the lines that say what it has."""
    from dvrk_cmaes.io.json_file import json_text

    if json:
        print(json_text(document), end="")
    else:
        show(lines)


def tracked(items: Iterable[T], what: str, total: int | None = None) -> Iterable[T]:
    """Iterate over items with a progress bar if stderr is a terminal."""
    from rich.progress import track

    return track(items, what, total, console=error_console(), disable=not error_console().is_terminal)


@contextlib.contextmanager
def progress() -> Iterator[Callable[[int, int, str], None]]:
    """Give a function that shows how many of all frames or parts are done: in a bar on a terminal, or in lines.

    A smaller number than before begins another stage. Within another one it is that one's.
    """
    if _shown:
        yield _shown[-1]
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = error_console()
    started = last = before = time.monotonic()
    said = TextColumn("{task.fields[said]}")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), said)
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("done", total=None, said="starting")

        def report(done: int, total: int, more: str = "") -> None:
            nonlocal started, last, before
            now = time.monotonic()
            if done < bar.tasks[task].completed:
                started = before
                bar.reset(task, total=total)
            rate = f"{done / max(now - started, 1e-9):.2f} a second"
            bar.update(task, completed=done, total=total, said=f"{rate}{more}")
            before = now
            if not console.is_terminal and now - last >= _LINE_EVERY:
                last = now
                note(f"{done} of {total} done, {rate}{more}")

        _shown.append(report)
        try:
            yield report
        finally:
            _shown.pop()


@contextlib.contextmanager
def attended(**by: Any) -> Iterator[Workers]:
    """Give what a run is done by, fields of `Workers`, which shows its progress, and which Ctrl-C stops."""
    from dvrk_cmaes.runs.pool import Workers

    with stopping_on_interrupt() as stop, progress() as report:
        yield Workers(stop=stop, report=report, notice=note, **by)


def exit_code(statuses: Iterable[str]) -> int:
    """Return the exit code of a command with the statuses of its frames: 1 if all failed, 3 if one is not ok."""
    found = set(statuses)
    return FAILED if found == {"failed"} else DOUBTFUL if found - {"ok"} else 0


@contextlib.contextmanager
def stopping_on_interrupt(said: str = _STOPPING, *, seconds: float = math.inf) -> Iterator[threading.Event]:
    """Give an event that is set by the first Ctrl-C (or SIGTERM, SIGHUP); the second one raises KeyboardInterrupt.

    It is set after some ``seconds``, too. Signals are not handled outside the main thread, nor SIGHUP, of a closed
    terminal, where nohup ignores it.
    """
    stop = threading.Event()
    timer = threading.Timer(min(seconds, threading.TIMEOUT_MAX), stop.set)
    timer.daemon = True
    if seconds < math.inf:
        timer.start()

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
        if said:
            warn(said)

    hang_up = [] if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else [signal.SIGHUP]
    handled = (signal.SIGINT, signal.SIGTERM, *hang_up)
    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, handle) for number in handled}
    try:
        yield stop
    finally:
        timer.cancel()
        for number, handler in before.items():
            signal.signal(number, handler)
