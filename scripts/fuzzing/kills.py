"""Commands that are killed, without disk or streams, or with their clock set back, also over an earlier result.

After a few faults in the same folder, the command is run to its end: it must end well, and the files must be those of a
run without a fault. Before that, all documents and pictures must be whole, and no process may be left. The fault "kill
over an earlier result" lets two settings of a command replace each other's result; after each kill, the earlier or the
new result must be there, whole.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import psutil

from fuzzing.runs import DONE, FRAME, LINES, QUICK, SHOWN, Report, damaged_files, fresh_copy, written

Line = tuple[str, ...]

_MADE: Final = ("--out", "made")
_VIDEO: Final = (*LINES["import"], "--overwrite", *_MADE)
COMMANDS: Final[dict[str, Line]] = {
    "batch": ("batch", "session", *QUICK, "--workers", "2", *_MADE),
    "calibrate": ("calibrate", "session", *QUICK, "--workers", "2", "--results", "results", *_MADE),
    "track": (*LINES["track"], *_MADE),
    "import": _VIDEO,
    "estimate": (*FRAME, "--mask", "session/masks/0000.png", *_MADE),
    "export": (*LINES["export"], *_MADE),
    "golden record": ("golden", "record", "session", *QUICK, "--overwrite"),
}
"""Command lines, run in the folder of the material; the last one writes session/golden.json, the others ``made``."""

_SOLVE: Final = ("calibrate", "session", "--workers", "1", "--results", "results", *_MADE, "--config")
REPLACING: Final[dict[str, tuple[Line, Line]]] = {
    "segment": ((*LINES["segment"], *_MADE), (*LINES["segment"], *_MADE, "--box", "20,20,150,110")),
    "import": (_VIDEO, (*_VIDEO, "--every", "2")),
    "calibrate": ((*_SOLVE, "quick.toml"), (*_SOLVE, "other.toml")),
}
"""Two command lines each that make different files in the same folder."""

OVER: Final = "kill over an earlier result"
FAULTS: Final = ("kill", "kill worker", "kill both", "terminate", "full disk", "clock", "closed", OVER)
_OF_WORKERS: Final = ("kill worker", "kill both")
_WITH_WORKERS: Final = ("batch", "calibrate")
_IN_A_ROW: Final = 4  # faults, at most
_LONGEST: Final = 300.0  # s, of a command
_ORPHANS: Final = 60.0  # s, after which the workers of a killed command must have ended


@dataclass(frozen=True)
class _Ended:
    """How a command ended: its exit code, its stderr, and how long it ran, s."""

    code: int
    err: str
    seconds: float

    @property
    def fault(self) -> list[str]:
        """What is wrong about it if it should have ended well."""
        return [] if self.code in DONE else [f"exit code {self.code}: {self.err.strip()[-SHOWN:]}"]


def fuzz_kills(
    tries: int,
    seed: int,
    material: Path,
    place: Path,
    commands: Sequence[str] = tuple(COMMANDS),
    faults: Sequence[str] = FAULTS,
) -> Report:
    """Let a number of faults happen at random times; ``place`` is a folder for copies of the material.

    A command has one to four faults in a row in the same folder, and is then run to its end.
    """
    report, chance = Report("kills"), random.Random(seed)
    over = [name for name in REPLACING if name in commands] if OVER in faults else []
    for number, name in enumerate(over):
        count = tries // 4 if len(faults) > 1 else tries
        share = count // len(over) + (number < count % len(over))
        _kill_over(report, fresh_copy(material, place), name, share, chance)
    faults = [one for one in faults if one != OVER]
    runs = {name: _undisturbed(fresh_copy(material, place), name) for name in (commands if faults else ())}
    for name in itertools.cycle(runs):
        left = tries - report.tries.total()
        if left <= 0:
            break
        count = min(left, chance.randint(1, _IN_A_ROW))
        for violation in _attempt(fresh_copy(material, place), name, runs[name], faults, report, count, chance):
            report.violations.append(f"  {report.tries.total()} faults, {name}: {violation}")
        print(report, file=sys.stderr, flush=True)
    return report


def _written_by(place: Path, name: str) -> Path:
    return place / ("session/golden.json" if name.startswith("golden") else "made")


def _undisturbed(place: Path, name: str) -> tuple[dict[str, Any], float]:
    """Run a command without a fault; return what it wrote, and how long it ran, s."""
    ended = _run(place, COMMANDS[name])
    if ended.fault:
        raise SystemExit(f"fuzz: {name} without a fault: {ended.fault[0]}")
    return written(_written_by(place, name)), ended.seconds


def _attempt(
    place: Path,
    name: str,
    usual: tuple[dict[str, Any], float],
    faults: Sequence[str],
    report: Report,
    count: int,
    chance: random.Random,
) -> Iterator[str]:
    """Run a command with some faults one after the other, then without; yield what was violated."""
    made, (files, seconds) = _written_by(place, name), usual
    chosen = [one for one in faults if name in _WITH_WORKERS or one not in _OF_WORKERS] or ["kill"]
    for _ in range(count):
        fault = chance.choice(chosen)
        found = _suffer(place, name, fault, seconds, chance)
        if found is None:  # it had ended before
            break
        report.tries[f"{name} / {fault}"] += 1
        yield from (f"{fault}: {violation}" for violation in (*found, *damaged_files(made)))
    again = _run(place, COMMANDS[name])
    yield from again.fault
    if not again.fault:
        there = written(made)
        different = sorted(path for path in {*files, *there} if files.get(path) != there.get(path))
        if different:
            yield f"other files than without a fault: {', '.join(different)[:SHOWN]}"


def _suffer(place: Path, name: str, fault: str, seconds: float, chance: random.Random) -> list[str] | None:
    """Run a command with a fault; returns what was violated, or None if it was to be killed and had ended before."""
    match fault:
        case "full disk":
            ended = _run(place, COMMANDS[name], largest=chance.choice((0, 100, 1000, 10_000)))
            return _said_wrong(ended) if ended.code not in DONE else []
        case "clock":
            found = _run(place, COMMANDS[name]).fault
            made, tomorrow = _written_by(place, name), time.time() + 86400
            for path in (made, *made.rglob("*")) if made.is_dir() else (made,):
                os.utime(path, (tomorrow, tomorrow))
            return found
        case "closed":
            ended = _run(place, COMMANDS[name], closed=True)
            return [] if ended.code in DONE else [f"exit code {ended.code}"]
    return _killed(place, COMMANDS[name], fault, chance.uniform(0, seconds))


def _kill_over(report: Report, place: Path, name: str, tries: int, chance: random.Random) -> None:
    """Kill the two command lines of a name while each replaces the other's result."""
    (place / "other.toml").write_text((place / "quick.toml").read_text().replace("seed = 1", "seed = 2"))
    known: dict[int, dict[str, Any]] = {}
    seconds = 0.0
    for which in (1, 0):
        ended = _run(place, REPLACING[name][which])
        if ended.fault:
            raise SystemExit(f"fuzz: {name} without a fault: {ended.fault[0]}")
        known[which], seconds = written(place / "made"), ended.seconds
    if known[0] == known[1]:
        raise SystemExit(f"fuzz: {name}: both command lines make the same files")
    there = 0
    for _ in range(tries):
        report.tries[f"{name} / {OVER}"] += 1
        violated = _killed(place, REPLACING[name][1 - there], "kill", chance.uniform(0, seconds)) or []
        report.violations += [f"  {name}, {OVER}: {each}" for each in violated]
        now = written(place / "made") if (place / "made").is_dir() else None
        if now == known[1 - there]:
            there = 1 - there
        elif now != known[there]:
            report.violations.append(f"  {name}: neither the earlier nor the new result: {sorted(now or {})}"[:SHOWN])
            _run(place, REPLACING[name][there])
    again = _run(place, REPLACING[name][there])  # what is there is taken for the command's own
    left = [f"left behind: {path.name}" for path in place.iterdir() if path.name.endswith((".tmp", ".old"))]
    report.violations += [f"  {name}, {OVER}: {each}" for each in (*again.fault, *left)]


def _start(place: Path, line: Line, largest: int | None = None, *, closed: bool = False) -> subprocess.Popen[str]:
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
            [sys.executable, "-m", "dvrk_cmaes", *line],
            cwd=place,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE if largest is not None else err,
            text=True,
            start_new_session=True,
            preexec_fn=limit,
        )


def _run(place: Path, line: Line, largest: int | None = None, *, closed: bool = False) -> _Ended:
    """Run a command to its end."""
    began = time.monotonic()
    process = _start(place, line, largest, closed=closed)
    try:
        err = process.communicate(timeout=_LONGEST)[1]
    except subprocess.TimeoutExpired:
        _end_group(process.pid)
        return _Ended(-1, f"not ended after {_LONGEST:.0f} s", _LONGEST)
    text = (place / "stderr.txt").read_text() if err is None else err
    return _Ended(process.returncode, text, time.monotonic() - began)


def _killed(place: Path, line: Line, fault: str, seconds: float) -> list[str] | None:
    """Kill a running command, its first worker, or both, or terminate it; a violation if processes are left.

    Returns None if it ends before.
    """
    process = _start(place, line)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(seconds)
        return None
    if fault in _OF_WORKERS:
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
    return ["a traceback" + said[-SHOWN:]] if "Traceback" in said else []


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


def _said_wrong(ended: _Ended) -> list[str]:
    """Return what is wrong about the end of a command that could not write."""
    last = (ended.err.strip().splitlines() or [""])[-1]
    if "Traceback" in ended.err or "internal error" in ended.err or ended.code not in (1, 2):
        return ended.fault
    return [] if last.startswith("dvrk-cmaes: ") else [f"its last line is {last!r}"]
