"""Commands that are killed, without disk or streams, or with their clock set back.

After a few faults in the same folder, the command is run to its end: it must end well, and the files must be those of a
run without a fault. Before that, all documents and pictures must be whole, and no process may be left.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import psutil

from measure.fuzz.families import write_material
from measure.fuzz.written import damaged_files, written

_QUICK: Final = ["--config", "quick.toml"]
_VIDEO: Final = ["import", "video.avi", "--camera", "session/camera.yaml", "--joints", "times.csv"]
COMMANDS: Final[dict[str, tuple[list[str], str]]] = {
    "batch": (["batch", "session", *_QUICK, "--workers", "2", "--out", "made"], "made"),
    "calibrate": (["calibrate", "session", *_QUICK, "--workers", "2", "--results", "results", "--out", "made"], "made"),
    "track": (["track", "session", *_QUICK, "--out", "made"], "made"),
    "import": ([*_VIDEO, "--overwrite", "--out", "made"], "made"),
    "estimate": (
        [
            *("estimate", "--mask", "session/masks/0000.png", "--camera", "session/camera.yaml"),
            *("--joints", "session/joints.csv", *_QUICK, "--out", "made"),
        ],
        "made",
    ),
    "export": (["export", "results", "--to", "csv", "--out", "made"], "made"),
    "golden record": (["golden", "record", "session", *_QUICK, "--overwrite"], "session/golden.json"),
}
"""Command lines, and the file or folder that each writes, in the folder of the material."""

KILLS: Final = ("kill", "kill worker", "kill both", "terminate")
FAULTS: Final = (*KILLS, "full disk", "clock", "closed")
_OF_WORKERS: Final = ("kill worker", "kill both")
_WITH_WORKERS: Final = ("batch", "calibrate")
_IN_A_ROW: Final = 4  # faults, at most
_DONE: Final = (0, 3)  # exit codes
_LONGEST: Final = 300.0  # s, of a command
_ORPHANS: Final = 60.0  # s, after which the workers of a killed command must have ended
_SHOWN: Final = 300  # characters of a message


@dataclass
class KillReport:
    """Faults by command, and violations."""

    tries: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)

    @property
    def faults(self) -> int:
        """Number of faults."""
        return sum(self.tries.values())

    def __str__(self) -> str:
        counts = ", ".join(f"{name} {count}" for name, count in sorted(self.tries.items()))
        head = f"kills: {self.faults} tries, {len(self.violations)} violations"
        return "\n".join([head, f"  {counts}", *self.violations])


@dataclass(frozen=True)
class _Ended:
    """How a command ended: its exit code, its stderr, and how long it ran, s."""

    code: int
    err: str
    seconds: float


@dataclass(frozen=True)
class _Undisturbed:
    """A command without a fault: what it wrote, and how long it ran, s."""

    name: str
    files: dict[str, Any]
    seconds: float


def fuzz_kills(
    tries: int,
    seed: int,
    commands: Sequence[str] = tuple(COMMANDS),
    faults: Sequence[str] = FAULTS,
    material: Path | None = None,
) -> KillReport:
    """Let a number of faults happen at random times; ``material`` is that of the families.

    A command has one to four faults in a row in the same folder, and is then run to its end.
    """
    report, chance = KillReport(), random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        if material is None:
            material = Path(folder, "material")
            material.mkdir()
            write_material(material)
        runs = {name: _undisturbed(_copied(material, Path(folder, "try")), name) for name in commands}
        for name in itertools.cycle(commands):
            left = tries - report.faults
            if left <= 0:
                return report
            place = _copied(material, Path(folder, "try"))
            for violation in _attempt(
                place, runs[name], faults, report, min(left, chance.randint(1, _IN_A_ROW)), chance
            ):
                report.violations.append(f"  {report.faults} faults, {name}: {violation}")
            print(report, file=sys.stderr, flush=True)
    return report


def _undisturbed(place: Path, name: str) -> _Undisturbed:
    """Run a command without a fault."""
    ended = _run(place, name)
    if ended.code not in _DONE:
        raise SystemExit(f"fuzz: {name} without a fault ended with {ended.code}: {ended.err[-_SHOWN:]}")
    return _Undisturbed(name, written(place / COMMANDS[name][1]), ended.seconds)


def _attempt(
    place: Path, usual: _Undisturbed, faults: Sequence[str], report: KillReport, count: int, chance: random.Random
) -> Iterator[str]:
    """Run a command with some faults one after the other, then without; yield what was violated."""
    made = place / COMMANDS[usual.name][1]
    chosen = [one for one in faults if usual.name in _WITH_WORKERS or one not in _OF_WORKERS] or ["kill"]
    for _ in range(count):
        fault = chance.choice(chosen)
        found = _suffer(place, usual, fault, chance)
        if found is None:  # it had ended before
            break
        report.tries[f"{usual.name} / {fault}"] += 1
        yield from (f"{fault}: {violation}" for violation in (*found, *damaged_files(made)))
    again = _run(place, usual.name)
    yield from _refused(again)
    if again.code in _DONE:
        there = written(made)
        different = sorted(path for path in {*usual.files, *there} if usual.files.get(path) != there.get(path))
        if different:
            yield f"other files than without a fault: {', '.join(different)[:_SHOWN]}"


def _suffer(place: Path, usual: _Undisturbed, fault: str, chance: random.Random) -> list[str] | None:
    """Run a command with a fault; returns what was violated, or None if it was to be killed and had ended before."""
    name = usual.name
    match fault:
        case "full disk":
            ended = _run(place, name, largest=chance.choice((0, 100, 1000, 10_000)))
            return _said_wrong(ended) if ended.code not in _DONE else []
        case "clock":
            found = _refused(_run(place, name))
            _date_forward(place / COMMANDS[name][1])
            return found
        case "closed":
            ended = _run(place, name, closed=True)
            return [] if ended.code in _DONE else [f"exit code {ended.code}"]
    return _killed(place, name, fault, chance.uniform(0, usual.seconds))


def _start(place: Path, name: str, largest: int | None = None, *, closed: bool = False) -> subprocess.Popen[str]:
    """Start a command in a group of its own; ``largest`` is the size of files in bytes from which writing fails.

    With ``closed``, it has no standard streams.
    """

    def limit() -> None:
        if largest is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
        if closed:
            os.closerange(0, 3)

    with open(place / "stderr.txt", "w") as err:
        return subprocess.Popen(
            [sys.executable, "-m", "dvrk_cmaes", *COMMANDS[name][0]],
            cwd=place,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE if largest is not None else err,
            text=True,
            start_new_session=True,
            preexec_fn=limit,
        )


def _run(place: Path, name: str, largest: int | None = None, *, closed: bool = False) -> _Ended:
    """Run a command to its end."""
    began = time.monotonic()
    process = _start(place, name, largest, closed=closed)
    try:
        err = process.communicate(timeout=_LONGEST)[1]
    except subprocess.TimeoutExpired:
        _end_group(process.pid)
        return _Ended(-1, f"not ended after {_LONGEST:.0f} s", _LONGEST)
    text = (place / "stderr.txt").read_text() if err is None else err
    return _Ended(process.returncode, text, time.monotonic() - began)


def _killed(place: Path, name: str, fault: str, seconds: float) -> list[str] | None:
    """Kill a running command, its first worker, or both, or terminate it; a violation if processes are left.

    Returns None if it ends before.
    """
    process = _start(place, name)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(seconds)
        return None
    if fault in ("kill worker", "kill both"):
        workers = [one for one in _group(process.pid) if one.pid != process.pid]
        for worker in workers[:1]:
            with contextlib.suppress(psutil.NoSuchProcess):
                worker.kill()
    if fault in ("kill", "kill both"):
        process.kill()
    elif fault == "terminate":
        process.send_signal(signal.SIGTERM)
    try:
        process.wait(_LONGEST)
    except subprocess.TimeoutExpired:
        _end_group(process.pid)
        return [f"not ended after {_LONGEST:.0f} s"]
    limit = time.monotonic() + _ORPHANS
    while (left := _group(process.pid)) and time.monotonic() < limit:
        time.sleep(0.1)
    if left:
        _end_group(process.pid)
        return [f"{len(left)} processes are left"]
    said = (place / "stderr.txt").read_text()
    return ["a traceback" + said[-_SHOWN:]] if "Traceback" in said else []


def _group(leader: int) -> list[psutil.Process]:
    """Return the processes of a group that run."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, ProcessLookupError):
            if os.getpgid(process.pid) == leader and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def _end_group(leader: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(leader, signal.SIGKILL)


def _refused(ended: _Ended) -> list[str]:
    """Return what is wrong about a command that should have ended well."""
    return [] if ended.code in _DONE else [f"exit code {ended.code}: {ended.err.strip()[-_SHOWN:]}"]


def _said_wrong(ended: _Ended) -> list[str]:
    """Return what is wrong about the end of a command that could not write."""
    last = (ended.err.strip().splitlines() or [""])[-1]
    if "Traceback" in ended.err or "internal error" in ended.err or ended.code not in (1, 2):
        return [f"exit code {ended.code}: {ended.err.strip()[-_SHOWN:]}"]
    return [] if last.startswith("dvrk-cmaes: ") else [f"its last line is {last!r}"]


def _date_forward(made: Path) -> None:
    """Date files a day into the future, as after a clock was set back."""
    tomorrow = time.time() + 86400
    for path in (made, *made.rglob("*")) if made.is_dir() else (made,):
        os.utime(path, (tomorrow, tomorrow))


def _copied(material: Path, place: Path) -> Path:
    """Return a fresh copy of the material."""
    shutil.rmtree(place, ignore_errors=True)
    return Path(shutil.copytree(material, place, symlinks=True))
