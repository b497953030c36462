"""Runs of command lines for scripts/fuzz.py, in this process or in one of their own; what they wrote; and reports."""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final
from unittest import mock

from dvrk_cmaes.cli import main as run_command_line
from dvrk_cmaes.cli.app import app
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.results.folder import read_result
from dvrk_cmaes.runs.pool import Pool

QUICK: Final = ("--config", "quick.toml")
FRAME: Final = ("estimate", "--camera", "session/camera.yaml", "--joints", "session/joints.csv", *QUICK)
LINES: Final[dict[str, tuple[str, ...]]] = {
    "batch": ("batch", "session", *QUICK, "--workers", "1"),
    "calibrate": ("calibrate", "session", *QUICK, "--workers", "1", "--results", "results"),
    "track": ("track", "session", *QUICK),
    "segment": ("segment", "session"),
    "import": ("import", "video.avi", "--camera", "session/camera.yaml", "--joints", "times.csv"),
    "export": ("export", "results", "--to", "csv"),
}
"""Command lines, run in the folder of the material, without the folder that they write to."""

DONE: Final = (0, 3)
"""Exit codes of commands that did what they were asked for."""

SHOWN: Final = 300
"""Characters of a message that a report shows."""

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


@dataclass
class Report:
    """Numbers of tries by kind, how many were refused, and violations."""

    name: str
    tries: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    violations: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        head = f"{self.name}: {self.tries.total()} tries, {self.refused} refused, {len(self.violations)} violations"
        counts = "  " + ", ".join(f"{name} {count}" for name, count in sorted(self.tries.items()))
        return "\n".join([head, *([counts] if len(self.tries) > 1 else []), *self.violations])


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

    made = Pool.__init__

    def here_alone(self: Pool, start: Callable[[], object], _workers: int, **_: Any) -> None:
        made(self, start, 0, here=True)

    def done_here(self: Pool, call: Callable[..., Any], *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.start()
        try:
            future.set_result(call(*arguments))
        except Exception as error:  # as that of a worker process
            future.set_exception(error)
        return future

    @lru_cache(maxsize=100)
    def parsed(tokens: tuple[str, ...]) -> Callable[[], Any]:
        command, bound, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
        return partial(command, *bound.args, **bound.kwargs)

    with (
        mock.patch("dvrk_cmaes.runs.frame.estimate_views", estimate),
        mock.patch("dvrk_cmaes.estimation.image_frame.estimate_views", estimate),
        mock.patch.object(Pool, "__init__", here_alone),
        mock.patch.object(Pool, "submit", done_here),
        mock.patch("dvrk_cmaes.draw.overlay.SMALLEST", 1),
        mock.patch("dvrk_cmaes.cli.app.app", lambda tokens, **_: parsed(tuple(tokens))()),
    ):
        yield


_TIMES: Final = ("seconds", "timing", "run")
_READERS: Final[dict[str, Callable[[Path], Any]]] = {
    ".json": lambda path: json.loads(path.read_text()),
    ".jpg": read_image,
    ".png": read_image,
}


def fresh_copy(material: Path, place: Path) -> Path:
    """Make ``place`` a copy of the material without what an earlier command wrote to ``made``."""
    shutil.rmtree(place, ignore_errors=True)
    return Path(shutil.copytree(material, place, ignore=shutil.ignore_patterns("made"), symlinks=True))


def damaged_files(made: Path) -> list[str]:
    """Return which documents and pictures of a command are not whole; temporary files do not count."""
    found = []
    for path in [made] if made.is_file() else sorted(made.rglob("*")):
        if not _is_temporary(path, made) and (read := _READERS.get(path.suffix)) is not None:
            try:
                read(path)
            except (ValueError, InputError) as error:
                found.append(f"{path.name} is damaged: {error}")
    return found


def written(made: Path) -> dict[str, Any]:
    """Return the contents of a file or of a folder's files by name, without times; of a page and a video, nothing."""
    files = [made] if made.is_file() else [path for path in made.rglob("*") if path.is_file()]
    return {str(path.relative_to(made.parent)): _content(path) for path in files if not _is_temporary(path, made)}


def _is_temporary(path: Path, made: Path) -> bool:
    """Whether a path in a folder is hidden, as what a killed command had not finished is."""
    return any(part.startswith(".") for part in path.relative_to(made).parts)


def _content(path: Path) -> Any:
    match path.suffix:
        case ".html" | ".mp4":
            return None
        case ".json":
            document = json.loads(path.read_text())
            if path.name == "run.json":
                document.pop("files")  # digests of files with times
            return _without_times(document)
        case ".jsonl":
            return [_without_times(json.loads(line)) for line in path.read_text().splitlines()]
        case ".csv":
            rows = [line.split(",") for line in path.read_text().splitlines()]
            skipped = {k for k, name in enumerate(rows[0]) if name == "seconds"}
            return [[cell for k, cell in enumerate(row) if k not in skipped] for row in rows]
    return path.read_bytes()


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_times(inner) for name, inner in value.items() if name not in _TIMES}
    return [_without_times(inner) for inner in value] if isinstance(value, list) else value
