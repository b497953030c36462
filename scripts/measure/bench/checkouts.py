"""The speed of this checkout compared with that of another one, each frame, command and folder in turns."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.pose_error import PoseError, compare_poses
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.silhouette.prepare import prepare
from measure.accuracy.figures import RIGHT_MODE_DEG
from measure.bench.many_frames import repeated_results, repeated_session
from measure.places import ROOT

_FINISHED: Final = (0, 3)  # exit codes of a command that has estimated its frames

_PAGE_FRAMES: Final = 1000
_CALIBRATED: Final = 600  # frames
_MOVED_MM: Final = 0.05
_PAGE: Final = (
    "import sys; from pathlib import Path; from dvrk_cmaes.report.page import write_page; write_page(Path(sys.argv[1]))"
)
_WORKER: Final = """
import pickle, sys, time
answers, sys.stdout = sys.stdout.buffer, sys.stderr
from dvrk_cmaes import Camera, estimate, load_instrument, prepare
body = prepare(sys.argv[1])
while True:
    try:
        camera, joints, mask, ignore = pickle.load(sys.stdin.buffer)
    except EOFError:
        break
    started = time.perf_counter(), time.process_time()
    found = estimate(mask, Camera(**camera), joints, body, ignore=ignore)
    seconds = time.perf_counter() - started[0], time.process_time() - started[1]
    pickle.dump((seconds, found.camera_from_root, found.joints, found.evaluations), answers)
    answers.flush()
"""
"""Estimates frames that it reads from stdin with the public names of any release; writes answers to stdout."""


@dataclass(frozen=True)
class Checkout:
    """A checkout whose package is imported by processes of their own, compiled into the folder ``compiled``.

    ``cache`` is the folder in which its commands keep the instruments that they have measured.
    """

    name: str
    folder: Path
    compiled: str
    cache: str

    @property
    def environment(self) -> dict[str, str]:
        """The environment variables of its processes."""
        given = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        return {**given, **one, "PYTHONPATH": str(self.folder), "PYTHONPYCACHEPREFIX": self.compiled}

    def run(self, arguments: Sequence[str], folder: Path, **variables: str) -> int:
        """Run a command in a folder, and return its exit code; InputError if it has not estimated its frames."""
        return self.run_python(["-m", "dvrk_cmaes", *arguments], folder, **variables)

    def run_python(self, arguments: Sequence[str], folder: Path, **variables: str) -> int:
        """Run Python with arguments in a folder, and return its exit code; InputError as `run`."""
        done = subprocess.run(
            [sys.executable, *arguments],
            env=self.environment | variables,
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode not in _FINISHED:
            said = done.stderr.strip()[-300:]
            raise InputError(f"{self.folder}: python {' '.join(arguments)}: {said}")
        return done.returncode


@contextmanager
def two_checkouts(this: Path, other: Path, *, timed: bool = True) -> Iterator[tuple[Checkout, Checkout]]:
    """Yield the checkout of --checkout and that of --against; InputError if one has not the package.

    If they are ``timed``, each compiles other packages for itself, too; otherwise what one has compiled serves both,
    and also later comparisons, if PYTHONPYCACHEPREFIX names a folder for that.
    """
    for option, folder in (("--checkout", this), ("--against", other)):
        if not (folder / "dvrk_cmaes" / "__init__.py").is_file():
            raise InputError(f"{option} {folder}: expected a checkout with the package dvrk_cmaes")
    with tempfile.TemporaryDirectory() as made:
        once = os.environ.get("PYTHONPYCACHEPREFIX", f"{made}/once")
        first, second = (
            Checkout(name, folder.resolve(), f"{made}/compiled by {name}" if timed else once, f"{made}/cache of {name}")
            for name, folder in (("this", this), ("other", other))
        )
        yield first, second


class _Answer(NamedTuple):
    """Wall and processor seconds of an estimate, its pose and joints, and the number of silhouettes drawn."""

    seconds: tuple[float, float]
    pose: NDArray[np.float64]
    joints: dict[str, float]
    silhouettes: int


@contextmanager
def _worker(checkout: Checkout, instrument: str) -> Iterator[Callable[[dict[str, Any]], _Answer]]:
    """Start a process that estimates frames; yields a function of a frame that returns its answer."""
    command = [sys.executable, "-c", _WORKER, instrument]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=checkout.environment, stdin=pipe, stdout=pipe, cwd=checkout.folder) as process:
        given, answers = process.stdin, process.stdout
        assert given is not None
        assert answers is not None

        def measure(frame: dict[str, Any]) -> _Answer:
            pickle.dump((frame["camera"], frame["joints"], frame["mask"], frame["ignore"]), given)
            given.flush()
            return _Answer(*pickle.load(answers))

        yield measure
        given.close()


def _frame(session: Session, files: FrameFiles) -> dict[str, Any]:
    """Read a frame as arrays and plain values."""
    data = read_frame(files, session.camera)
    camera = data.camera
    names = ("width", "height", "fx", "fy", "cx", "cy", "distortion", "model")
    return {
        "camera": {name: getattr(camera, name) for name in names},
        "joints": dict(files.readings),
        "mask": data.mask,
        "ignore": data.ignore,
    }


def checkouts_report(
    instrument: str,
    sessions: Sequence[Path],
    *,
    other: Path,
    frames: int | None,
    repeats: int,
    results: Path | None = None,
    recording: Path | None = None,
    tests: bool = False,
) -> dict[str, Any]:
    """Measure estimates, whole commands, a folder with two workers and its page, of this checkout and of another one.

    Estimates run in one process for each checkout, and each frame in turns; where the truth is known, the errors of
    both are compared. The first frame and the first command of each checkout are not measured. The folder is the
    session of that name with medium in it, or else the middle one. With ``recording`` and the ``results`` of batch for
    it, calibrations of `_CALIBRATED` frames are measured too, and with ``tests`` all tests of both checkouts.
    """
    body = prepare(instrument)
    read = [read_session(folder, known=body.instrument.joint_names) for folder in sessions]
    inputs = [(one, files) for one in read for files in one.frames[:frames]]
    camera = str(sessions[0] / "camera.yaml")
    pages = _PAGE_FRAMES if frames is None else 10 * frames
    folder = next((one for one in sessions if one.name.startswith("medium")), sessions[len(sessions) // 2])
    with two_checkouts(ROOT, other, timed=frames is None) as both:
        answers = _answers(both, instrument, inputs)
        report = {
            "estimate, seconds a frame": _estimates(both, answers),
            **_errors(body.instrument, inputs, answers),
            "whole command, seconds": _commands(both, instrument, inputs, repeats),
            "--help, seconds": _small_commands(both, ["--help"], repeats),
            "inspect, a camera file, seconds": _small_commands(both, ["inspect", camera], repeats),
            **_folders(both, instrument, folder, repeats, pages),
        }
        if recording is not None and results is not None:
            count = _CALIBRATED if frames is None else 2 * frames
            title = f"calibrate after batch, {count} frames, two workers, seconds"
            report[title] = _calibrations(both, instrument, recording, results, count)
        if tests:
            report["the tests, seconds"] = _tests(both)
        return report


def _answers(
    both: Sequence[Checkout], instrument: str, inputs: Sequence[tuple[Session, FrameFiles]]
) -> list[tuple[_Answer, _Answer]]:
    """Estimate each frame in each checkout in turns; returns the answers of this one and of the other one."""
    with _worker(both[0], instrument) as this, _worker(both[1], instrument) as other:
        first = _frame(*inputs[0])
        for measure in (this, other):
            measure(first)
        answers = []
        for number, one in enumerate(inputs):
            frame = _frame(*one)
            order = (this, other) if number % 2 else (other, this)
            measured = {measure: measure(frame) for measure in order}
            answers.append((measured[this], measured[other]))
    return answers


def _estimates(both: Sequence[Checkout], answers: Sequence[tuple[_Answer, _Answer]]) -> list[dict[str, Any]]:
    """Return a row of the times of all frames for each checkout, and one for their ratio."""
    table = np.array([[one.seconds for one in pair] for pair in answers])  # (frames, checkouts, wall and processor)
    wall, processor = table[..., 0], table[..., 1]
    drawn = np.mean([[one.silhouettes for one in pair] for pair in answers], axis=0)
    rows = [
        {
            "checkout": checkout.name,
            "frames": len(table),
            "wall, median": float(np.median(wall[:, k])),
            "wall, most": float(wall[:, k].max()),
            "processor, median": float(np.median(processor[:, k])),
            "processor, sum": float(processor[:, k].sum()),
            "silhouettes": float(drawn[k]),
        }
        for k, checkout in enumerate(both)
    ]
    ratio = {
        "checkout": "ratio",
        "wall, median": float(np.median(wall[:, 0] / wall[:, 1])),
        "wall, most": float(wall[:, 0].max() / wall[:, 1].max()),
        "processor, median": float(np.median(processor[:, 0] / processor[:, 1])),
        "processor, sum": float(processor[:, 0].sum() / processor[:, 1].sum()),
        "silhouettes": float(drawn[0] / drawn[1]),
    }
    return [*rows, ratio]


def _errors(
    instrument: Instrument,
    inputs: Sequence[tuple[Session, FrameFiles]],
    answers: Sequence[tuple[_Answer, _Answer]],
) -> dict[str, list[dict[str, Any]]]:
    """Compare the answers with the truth, where it is known; returns a row for each level.

    A level is the name of a session's folder up to its first digit. Tips are median errors; ``moved`` counts the frames
    whose tips' errors differ by more than `_MOVED_MM`.
    """
    levels: dict[str, list[tuple[PoseError, ...]]] = {}
    for (session, files), pair in zip(inputs, answers, strict=True):
        truth = session.truth.frames.get(files.name)
        if truth is not None:
            true = truth.camera_from_root, truth.joints
            errors = tuple(compare_poses(instrument, (one.pose, one.joints), true) for one in pair)
            level = re.split(r"[\d-]", session.folder.resolve().name)[0]
            levels.setdefault(level, []).append(errors)
    rows = []
    for level, of_frames in levels.items():
        tips = np.array([[one.tip_mm or 0.0 for one in pair] for pair in of_frames])
        right = np.array([[one.rotation_deg < RIGHT_MODE_DEG for one in pair] for pair in of_frames])
        this, other = (float(value) for value in np.median(tips, axis=0))
        rows.append(
            {
                "level": level,
                "frames": len(of_frames),
                "right mode, this": int(right[:, 0].sum()),
                "right mode, other": int(right[:, 1].sum()),
                "tips mm, this": this,
                "tips mm, other": other,
                "ratio": this / max(other, 1e-9),
                "moved": int((np.abs(tips[:, 0] - tips[:, 1]) > _MOVED_MM).sum()),
            }
        )
    return {"errors": rows} if rows else {}


def _calibrations(
    both: Sequence[Checkout], instrument: str, recording: Path, results: Path, count: int
) -> list[dict[str, Any]]:
    """Measure the command calibrate with two workers on the frames of a recording that have results, repeated."""
    measured = {}
    with tempfile.TemporaryDirectory() as place:
        known = {path.stem for path in (results / "frames").glob("*.json")}
        session = repeated_session(recording, Path(place, "session"), count, known)
        alone = repeated_results(results, Path(place, "results"), count)
        for checkout in both:
            out = str(Path(place, checkout.name))
            arguments = ["calibrate", str(session), "--results", str(alone), "--out", out, "--workers", "2"]
            measured[checkout.name] = [_timed(checkout, [*arguments, "--instrument", instrument])]
    return _rows(measured)


def _tests(both: Sequence[Checkout]) -> list[dict[str, Any]]:
    """Measure all tests of each checkout, on all cores."""
    arguments = ["-m", "pytest", "-q", "-n", "auto", "tests"]
    return _rows({checkout.name: [_timed_python(checkout, arguments)] for checkout in both})


def _timed(checkout: Checkout, arguments: Sequence[str]) -> tuple[float, float]:
    """Run a command of a checkout; returns wall and processor seconds of its processes."""
    return _timed_python(checkout, ["-m", "dvrk_cmaes", *arguments])


def _timed_python(checkout: Checkout, arguments: Sequence[str]) -> tuple[float, float]:
    """Run Python with a checkout's package; returns wall and processor seconds of its processes."""
    before, started = os.times(), time.perf_counter()
    checkout.run_python(arguments, checkout.folder)
    wall, after = time.perf_counter() - started, os.times()
    return wall, after.children_user + after.children_system - before.children_user - before.children_system


def _commands(
    both: Sequence[Checkout], instrument: str, inputs: Sequence[tuple[Session, FrameFiles]], repeats: int
) -> list[dict[str, Any]]:
    """Measure the command estimate, from start to exit, on frames spread over the sessions."""
    places = [0, *np.linspace(0, len(inputs) - 1, repeats).round().astype(int)]
    chosen = [inputs[i] for i in places]
    measured: dict[str, list[tuple[float, float]]] = {one.name: [] for one in both}
    for session, files in chosen:
        folder = session.folder
        arguments = ["estimate", "--mask", str(files.mask), "--json"]
        arguments += ["--camera", str(folder / "camera.yaml"), "--joints", str(folder / "joints.csv")]
        for checkout in both:
            measured[checkout.name].append(_timed(checkout, [*arguments, "--instrument", instrument]))
    return _rows({name: times[1:] for name, times in measured.items()})


def _small_commands(both: Sequence[Checkout], arguments: Sequence[str], repeats: int) -> list[dict[str, Any]]:
    """Measure a command that estimates nothing, from start to exit; the first run of each checkout compiles it."""
    measured: dict[str, list[tuple[float, float]]] = {one.name: [] for one in both}
    for _ in range(1 + repeats):
        for checkout in both:
            measured[checkout.name].append(_timed(checkout, arguments))
    return _rows({name: times[1:] for name, times in measured.items()})


def _folders(
    both: Sequence[Checkout], instrument: str, session: Path, repeats: int, pages: int
) -> dict[str, list[dict[str, Any]]]:
    """Measure the command batch on a session with two workers, and the page of its results repeated to ``pages``."""
    measured: dict[str, list[tuple[float, float]]] = {one.name: [] for one in both}
    written: dict[str, list[tuple[float, float]]] = {one.name: [] for one in both}
    sizes: dict[str, int] = {}
    frames = 0
    for _ in range(max(repeats // 5, 1)):
        for checkout in both:
            with tempfile.TemporaryDirectory() as place:
                out, many = Path(place, "out"), Path(place, "many")
                arguments = ["batch", str(session), "--out", str(out), "--workers", "2", "--instrument", instrument]
                measured[checkout.name].append(_timed(checkout, arguments))
                frames = len(list((out / "frames").iterdir()))
                repeated_results(out, many, pages)
                written[checkout.name].append(_timed_python(checkout, ["-c", _PAGE, str(many)]))
                sizes[checkout.name] = (many / "report.html").stat().st_size
    rows, page_rows = _rows(measured), _rows(written)
    for row in rows[:2]:
        row["frames a second"] = frames / row["wall, median"]
    for row in page_rows[:2]:
        row["MB"] = sizes[row["checkout"]] / 1e6
    return {"folder, two workers, seconds": rows, f"page, of {pages} frames, seconds and bytes": page_rows}


def _rows(measured: dict[str, list[tuple[float, float]]]) -> list[dict[str, Any]]:
    """Return a row of medians for each checkout, and one of their ratios."""
    rows = {}
    for name, times in measured.items():
        (wall, processor), (least, _) = np.median(times, axis=0).tolist(), np.min(times, axis=0).tolist()
        rows[name] = {"wall, median": wall, "wall, least": least, "processor, median": processor}
    ratio = {figure: rows["this"][figure] / rows["other"][figure] for figure in rows["this"]}
    counted = [{"checkout": name, "runs": len(measured[name]), **row} for name, row in rows.items()]
    return [*counted, {"checkout": "ratio", **ratio}]
