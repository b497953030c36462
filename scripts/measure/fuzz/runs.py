"""Runs of command lines for scripts/fuzz.py: in this process, without what is slow, or in a process of its own."""

from __future__ import annotations

import contextlib
import io
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final
from unittest import mock

from dvrk_cmaes.cli import main as run_command_line
from dvrk_cmaes.cli.app import app
from dvrk_cmaes.results.file import read_result
from dvrk_cmaes.runs.processes import Processes

SLOW: Final = 30.0
"""Most seconds of processor time of a command line; after twice that by the clock it is ended."""


@dataclass(frozen=True)
class Outcome:
    """Exit code and output of a command line, seconds of processor time, and largest memory in MB if it is measured."""

    code: int
    out: str
    err: str
    seconds: float
    megabytes: float = 0.0


Runner = Callable[[list[str]], Outcome]


def in_this_process(command: list[str]) -> Outcome:
    """Run a command line in this process; after a minute it gets a RuntimeError."""
    out, err = io.StringIO(), io.StringIO()
    with tempfile.TemporaryFile() as native:
        stderr = os.dup(2)
        os.dup2(native.fileno(), 2)
        began = time.process_time()
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), _alarm(_time_is_up):
                code = run_command_line(command)
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        native.seek(0)
        printed = native.read().decode(errors="replace")
    return Outcome(code, out.getvalue(), printed + err.getvalue(), time.process_time() - began)


def in_a_process(command: list[str]) -> Outcome:
    """Run a command line in a process of its own, whose files are limited to 100 MB; it is killed after 60 s.

    Null characters are left out: no process can be given them.
    """
    arguments = [argument.replace("\0", "") for argument in command]
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = subprocess.Popen(
            [sys.executable, "-m", "dvrk_cmaes", *arguments],
            stdout=out,
            stderr=err,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (10**8, 10**8)),
        )
        with _alarm(process.kill):
            _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        seconds = used.ru_utime + used.ru_stime
        return Outcome(process.returncode, out.read(), err.read(), seconds, used.ru_maxrss / 1e3)


@contextlib.contextmanager
def _alarm(call: Callable[[], None]) -> Iterator[None]:
    """Call a function after a minute, unless the context is left before."""
    before = signal.signal(signal.SIGALRM, lambda *_: call())
    signal.alarm(int(2 * SLOW))
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _time_is_up() -> None:
    raise RuntimeError(f"not ended after {2 * SLOW:.0f} s")


@contextlib.contextmanager
def stubbed(material: Path) -> Iterator[None]:
    """Replace what is slow and reads no file, in this process.

    The estimate of a frame is a stored result, worker processes are calls, drawings are not enlarged, and a command
    line that was parsed before is not parsed again.
    """
    stored = read_result(material / "results" / "frames" / "0000.json")

    def estimate(*_: Any, frame: str = "", **__: Any) -> Any:
        return replace(stored, frame=frame)

    made = Processes.__init__

    def here_alone(self: Processes, start: Callable[[], object], _workers: int, **_: Any) -> None:
        made(self, start, 0, here=True)

    @lru_cache(maxsize=100)
    def parsed(tokens: tuple[str, ...]) -> Callable[[], Any]:
        command, bound, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
        return partial(command, *bound.args, **bound.kwargs)

    with (
        mock.patch("dvrk_cmaes.runs.frame.estimate_views", estimate),
        mock.patch("dvrk_cmaes.estimation.image_frame.estimate_views", estimate),
        mock.patch.object(Processes, "__init__", here_alone),
        mock.patch("dvrk_cmaes.draw.overlay._SMALLEST", 1),
        mock.patch("dvrk_cmaes.cli.app.app", lambda tokens, **_: parsed(tuple(tokens))()),
    ):
        yield
