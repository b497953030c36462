"""Commands that are killed while they replace an earlier result: the earlier one or the new one is there, whole.

The two are made by different settings of the same command. After each kill the next run must be accepted.
"""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from measure.fuzz.written import written

_VIDEO: Final = ("import", "video.avi", "--camera", "session/camera.yaml", "--joints", "times.csv", "--overwrite")
_SOLVE: Final = ("calibrate", "session", "--workers", "1", "--results", "results", "--config")
COMMANDS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "segment": (("segment", "session"), ("segment", "session", "--box", "20,20,150,110")),
    "import": (_VIDEO, (*_VIDEO, "--every", "2")),
    "calibrate": ((*_SOLVE, "quick.toml"), (*_SOLVE, "other.toml")),
}
"""Two command lines each, without ``--out``, that make different files."""

_DONE: Final = (0, 3)  # exit codes


@dataclass
class EarlierReport:
    """Number of kills, after how many the earlier and the new result was there, and violations."""

    earlier: int = 0
    new: int = 0
    violations: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        tries = self.earlier + self.new + len(self.violations)
        head = f"earlier: {tries} kills: earlier result {self.earlier}, new one {self.new}"
        return "\n".join([f"{head}, {len(self.violations)} violations", *self.violations])


def fuzz_earlier(
    tries: int, seed: int, material: Path, place: Path, commands: tuple[str, ...] = tuple(COMMANDS)
) -> EarlierReport:
    """Kill commands at random moments, ``tries`` in all; ``place`` is a folder for a copy of the material."""
    report, chance = EarlierReport(), random.Random(seed)
    for number, name in enumerate(commands):
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(material, place)
        shutil.rmtree(place / "made", ignore_errors=True)
        (place / "other.toml").write_text((place / "quick.toml").read_text().replace("seed = 1", "seed = 2"))
        known: list[dict[str, Any]] = []
        seconds = 0.0
        for which in (1, 0):
            began = time.monotonic()
            _ended_well(name, _start(place, name, which))
            seconds = time.monotonic() - began
            known.insert(0, written(place / "made"))
        if known[0] == known[1]:
            raise SystemExit(f"fuzz: {name}: both command lines make the same files")
        there = 0
        for _ in range(tries // len(commands) + (number < tries % len(commands))):
            with _start(place, name, 1 - there) as process:
                try:
                    process.communicate(timeout=chance.uniform(0, seconds))
                except subprocess.TimeoutExpired:
                    process.kill()
            now: dict[str, Any] | None = written(place / "made") if (place / "made").is_dir() else None
            if now == known[there]:
                report.earlier += 1
            elif now == known[1 - there]:
                report.new, there = report.new + 1, 1 - there
            else:
                report.violations.append(f"  {name}: neither the earlier nor the new result: {sorted(now or {})}"[:400])
                _ended_well(name, _start(place, name, there))
        _ended_well(name, _start(place, name, there))  # what is there is taken for the command's own
        left = [path.name for path in place.iterdir() if path.name.endswith((".tmp", ".old"))]
        if left:
            report.violations.append(f"  {name}: left behind: {', '.join(left)}")
    return report


def _start(place: Path, name: str, which: int) -> subprocess.Popen[str]:
    """Start one of the two command lines."""
    command = [sys.executable, "-m", "dvrk_cmaes", *COMMANDS[name][which], "--out", "made"]
    return subprocess.Popen(command, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def _ended_well(name: str, process: subprocess.Popen[str]) -> None:
    """Wait for a command; SystemExit if it fails."""
    with process:
        err = process.communicate()[1]
    if process.returncode not in _DONE:
        raise SystemExit(f"fuzz: {name} ended with {process.returncode}: {err[-300:]}")
