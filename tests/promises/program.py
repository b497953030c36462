"""The program as its users have it: commands with their output, and the files that they read and write."""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "data" / "demo"
PROGRAM = Path(sys.executable).with_name("dvrk-cmaes")
CAMERA = """image_width: 320
image_height: 240
camera_matrix: {rows: 3, cols: 3, data: [521.3, 0, 163.0, 0, 519.0, 117.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""
"""A camera of a quarter of the usual pixels, for quick worlds."""

EASY = ("--level", "easy", "--frames", 8, "--seed", 5, "--no-images")
EYES = ("--stereo", "--level", "medium", "--frames", 4, "--seed", 2, "--no-images")
TOOLS = ("--arms", 2, "--level", "easy", "--frames", 4, "--seed", 3, "--no-images")

QUICK = "[search]\nsamples = 128\nstarts = 2\nevaluations = 160\n[session]\ntest_camera = false\n"
"""Settings of a short search and of a camera that is not tested, for tests of what is done with results."""

_MAIN = next(iter(entry_points(group="console_scripts", name="dvrk-cmaes"))).load()


@dataclass(frozen=True)
class Ran:
    """Exit code and output of a command, and the folder that it wrote where that is kept."""

    code: int
    out: str
    err: str
    folder: Path = Path()

    @property
    def refusal(self) -> str:
        """The one line about wrong usage or input, without the program's name; nothing else is printed."""
        assert (self.code, self.out) == (2, ""), self
        assert self.err.count("\n") == 1, self.err
        assert self.err.startswith("dvrk-cmaes: ")
        return self.err.removeprefix("dvrk-cmaes: ").strip()

    @property
    def document(self) -> Any:
        """The JSON on stdout."""
        return json.loads(self.out)


def run(*arguments: object, folder: Path | None = None) -> Ran:
    """Run a command in this process, with the program's entry point, in a folder."""
    out, err = io.StringIO(), io.StringIO()
    words = ["dvrk-cmaes", *map(str, arguments)]
    with ExitStack() as stack:
        stack.enter_context(_signals_kept())
        stack.enter_context(mock.patch.object(sys, "argv", words))
        stack.enter_context(redirect_stdout(out))
        stack.enter_context(redirect_stderr(err))
        if folder:
            stack.enter_context(chdir(folder))
        code = _MAIN()
    return Ran(code, out.getvalue(), err.getvalue())


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Restore the handlers of signals, which the entry point replaces."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass(frozen=True)
class Kept:
    """Runs commands once for all tests and processes, by their arguments."""

    base: Path

    def __call__(self, *arguments: object) -> Ran:
        """Run a command that writes a folder, or give what it wrote before; tests change such a folder in a copy."""
        words = [str(argument) for argument in arguments]
        words += ["--workers", "1"] if words[0] != "synth" else []  # tests run on all cores
        place = self.base / f"{words[0]}-{hashlib.sha256(repr(words).encode()).hexdigest()[:12]}"
        place.mkdir(exist_ok=True)
        with open(place / "lock", "w", encoding="utf-8") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (place / "ran.json").exists():
                ran = run(*words, *([] if words[0] == "synth" else ["--out"]), place / "out")
                assert ran.code in (0, 3), ran
                (place / "ran.json").write_text(json.dumps([ran.code, ran.out, ran.err]))
            code, out, err = json.loads((place / "ran.json").read_text())
        return Ran(code, out, err, place / "out")

    @property
    def quick(self) -> Path:
        """Settings of a short search."""
        return self._file("quick.toml", QUICK)

    def synth(self, *options: object) -> Path:
        """Draw a session, in images of 320 x 240 px."""
        return self("synth", "--camera", self._file("small.yaml", CAMERA), *options).folder

    def _file(self, name: str, text: str) -> Path:
        path = self.base / name
        if not path.exists():
            part = path.with_suffix(f".{os.getpid()}")
            part.write_text(text)
            part.replace(path)
        return path


def content(folder: Path) -> dict[str, bytes]:
    """Give all files of a folder, also hidden ones."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
