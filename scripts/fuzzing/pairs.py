"""Two commands at once in one folder: each result is there once, as of a run alone, and the folder's list is complete.

The second command begins at once, or at a random moment of the first one's run. Those that write other files wait for
each other, and both end well. Of those that write the same ones, the second may be refused in one line.
"""

from __future__ import annotations

import hashlib
import json
import random
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.io.output import HELD, RUN
from fuzzing.runs import DONE, FRAME, LINES, SHOWN, Report, damaged_files, fresh_copy, written

_FIRST, _SECOND = ((*FRAME, "--mask", f"session/masks/{name}.png") for name in ("0000", "0001"))
_EXPORT, _IMPORT, _OVER = LINES["export"], LINES["import"], (*LINES["import"], "--overwrite")
_OUT: Final = "made"


@dataclass(frozen=True)
class Pair:
    """Command lines without ``--out``, and how often they are taken in a round; ``both``: neither may be refused."""

    first: tuple[str, ...]
    second: tuple[str, ...]
    times: int = 1
    both: bool = False


PAIRS: Final[dict[str, Pair]] = {
    "estimate of two frames": Pair(_FIRST, _SECOND, 4, True),
    "estimate of a frame": Pair(_FIRST, _FIRST, 3, True),
    "export of two kinds": Pair(_EXPORT, (*_EXPORT[:-1], "bop"), 4, True),
    "export": Pair(_EXPORT, _EXPORT, 2, True),
    "import": Pair(_IMPORT, _IMPORT, 2),
    "import --overwrite": Pair(_OVER, _OVER, 2),
    **{name: Pair(LINES[name], LINES[name]) for name in ("batch", "calibrate", "track")},
}
"""Commands that are started together, by name; each writes to the same folder."""

_LONGEST: Final = 300.0  # s


def fuzz_pairs(tries: int, seed: int, material: Path, place: Path, pairs: tuple[str, ...] = tuple(PAIRS)) -> Report:
    """Start two commands at once, ``tries`` times; ``place`` is a folder for copies of the material."""
    report, chance = Report("pairs"), random.Random(seed)
    alone: dict[str, tuple[dict[str, Any], float]] = {}
    each = [name for name in pairs for _ in range(PAIRS[name].times)]
    for number in range(tries):
        name = each[number % len(each)]
        if name not in alone:
            alone[name] = _one_after_the_other(fresh_copy(material, place), PAIRS[name])
        wanted, seconds = alone[name]
        wait = chance.choice((0.0, chance.uniform(0, seconds)))
        report.tries[name] += 1
        refused, found = _at_once(fresh_copy(material, place), PAIRS[name], wanted, wait)
        report.refused += refused
        report.violations += [f"  run {number}, {name}, the second {wait:.2f} s later: {each}" for each in found]
    return report


def _one_after_the_other(place: Path, pair: Pair) -> tuple[dict[str, Any], float]:
    """Run the commands of a pair one after the other; return what is written, and how long the first one ran, s."""
    began = time.monotonic()
    code, err = _ended(_start(place, pair.first))
    seconds = time.monotonic() - began
    if code in DONE and pair.first != pair.second:
        code, err = _ended(_start(place, pair.second))
    if code not in DONE:
        raise SystemExit(f"fuzz: {' '.join(pair.first)}: exit code {code}: {err[-SHOWN:]}")
    return written(place / _OUT), seconds


def _at_once(place: Path, pair: Pair, wanted: dict[str, Any], wait: float) -> tuple[int, list[str]]:
    """Run a pair at once; return how many commands were refused, and what was violated."""
    processes = [_start(place, pair.first)]
    time.sleep(wait)
    processes.append(_start(place, pair.second))
    ended = [_ended(process) for process in processes]
    found = []
    refused = [(code, err) for code, err in ended if code not in DONE]
    if len(refused) > (not pair.both):
        found.append(f"{len(refused)} were refused")
    for code, err in refused:
        if code not in (1, 2) or len(err.splitlines()) != 1 or not err.startswith("dvrk-cmaes: ") or "internal" in err:
            found.append(f"exit code {code}: {err.strip()[-SHOWN:]}")
    made = place / _OUT
    there = written(made)
    different = sorted(name for name in {*wanted, *there} if wanted.get(name) != there.get(name))
    if different:
        found.append(f"other files than of a run alone: {', '.join(different)[:SHOWN]}")
    return len(refused), [*found, *damaged_files(made), *list_faults(made), *_left(place)]


def list_faults(made: Path) -> list[str]:
    """Return what is wrong with the lists of a folder and those in it: files not as a list says, or in none."""
    listed: dict[str, str] = {}
    for record in made.rglob(RUN):
        own = json.loads(record.read_text(encoding="utf-8"))["files"]
        listed |= {(record.parent / name).relative_to(made).as_posix(): digest for name, digest in own.items()}
    files = [path for path in made.rglob("*") if path.is_file() and not path.name.startswith(".") and path.name != RUN]
    there = {path.relative_to(made).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    off = sorted(name for name in {*listed, *there} if listed.get(name) != there.get(name))
    found = [f"not as the list says: {', '.join(off)[:SHOWN]}"] if off else []
    return found + [f"{path.relative_to(made)} is left" for path in made.rglob(HELD)]


def _left(place: Path) -> list[str]:
    """Return temporary files and folders that are left."""
    left = sorted(str(path.relative_to(place)) for path in place.rglob("*.tmp"))
    return [f"left behind: {', '.join(left)[:SHOWN]}"] if left else []


def _start(place: Path, command: tuple[str, ...]) -> subprocess.Popen[str]:
    """Start a command line that writes to the folder."""
    line = [sys.executable, "-m", "dvrk_cmaes", *command, "--out", _OUT]
    return subprocess.Popen(line, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def _ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Wait for a command; return its exit code and stderr."""
    with process:
        try:
            err = process.communicate(timeout=_LONGEST)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            return -1, f"not ended after {_LONGEST:.0f} s"
    return process.returncode, err
