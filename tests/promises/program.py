"""The program as its users have it: commands with their output, and the files that they read and write."""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "data" / "demo"
PROGRAM = Path(sys.executable).with_name("dvrk-cmaes")
OUT = "<out>"
"""Stands for a new folder in the arguments of a command whose output is kept."""

CAMERA = """image_width: 320
image_height: 240
camera_matrix: {rows: 3, cols: 3, data: [521.3, 0, 163.0, 0, 519.0, 117.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""
"""A camera of a quarter of the usual pixels, for quick worlds."""

QUICK = "[search]\nsamples = 128\nstarts = 2\nevaluations = 160\n"
"""Settings of a short search, for tests of what is done with results."""

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
        """Run a command, or give what it wrote before; OUT among the arguments is the folder that it writes.

        What tests change in such a folder they change in a copy.
        """
        words = [str(argument) for argument in arguments]
        words += ["--workers", "1"] if words[0] in ("batch", "calibrate", "track") else []  # tests run on all cores
        place = self.base / f"{words[0]}-{hashlib.sha256(repr(words).encode()).hexdigest()[:12]}"
        place.mkdir(exist_ok=True)
        with open(place / "lock", "w", encoding="utf-8") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (place / "ran.json").exists():
                ran = run(*(str(place / "out") if word == OUT else word for word in words))
                assert ran.code in (0, 3), ran
                (place / "ran.json").write_text(json.dumps([ran.code, ran.out, ran.err]))
            code, out, err = json.loads((place / "ran.json").read_text())
        return Ran(code, out, err, place / "out")


def synth(kept: Kept, *options: object) -> Path:
    """Draw a session once, in images of 320 x 240 px."""
    camera = kept.base / "small.yaml"
    if not camera.exists():
        camera.write_text(CAMERA)
    return kept("synth", OUT, "--camera", camera, *options).folder


def results(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the results of a folder by frame."""
    return {path.stem: json.loads(path.read_text()) for path in sorted((folder / "frames").iterdir())}


def tracks(folder: Path) -> dict[str, dict[str, Any]]:
    """Read a followed recording by frame."""
    rows = [json.loads(line) for line in (folder / "tracks.jsonl").read_text().splitlines()]
    return {row["frame"]: row for row in rows}


def truth(session: Path, arm: str = "") -> dict[str, dict[str, Any]]:
    """Read the true poses of a session by frame."""
    name = f"golden_{arm}.json" if arm else "golden.json"
    frames: dict[str, dict[str, Any]] = json.loads((session / name).read_text())["frames"]
    return frames


def matrix(document: Mapping[str, Any], name: str) -> np.ndarray:
    """Give a 4 x 4 transform of a document."""
    found = np.array(document[name], float)
    assert found.shape == (4, 4)
    return found


def tip_errors(found: Mapping[str, Any], true: Mapping[str, Any]) -> np.ndarray:
    """Give the distances (2,) of the jaw tips from their true positions, mm."""
    return np.linalg.norm(np.subtract(found["tips"], true["tips_camera_m"]), axis=1) * 1e3


def distance(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Give how far a transform is from the true one, in mm and degrees."""
    turn = np.linalg.inv(true[:3, :3]) @ found[:3, :3]
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0)))
    return float(np.linalg.norm(found[:3, 3] - true[:3, 3]) * 1e3), float(angle)


def content(folder: Path) -> dict[str, bytes]:
    """Give all files of a folder, also hidden ones."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def median(values: Sequence[float] | np.ndarray) -> float:
    """Give the median."""
    return float(np.median(values))
