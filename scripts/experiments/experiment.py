"""Common parts of the experiments: command line options, description of the run, and the three files written.

An experiment writes OUT/NAME.json (all figures), OUT/NAME.md (a table and the claims) and OUT/NAME.png. The claims are
results that the paper reports or that we expect; each is written with the information whether it holds in this run.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from figure import write_figure

from dvrk_cmaes.config import __version__
from dvrk_cmaes.io.atomic import write_json, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT: Final = Path(__file__).resolve().parents[2]
OUT: Final = ROOT / "data" / "experiments"
SHARED: Final = ROOT.parent / "shared"
"""Real frames and scanned meshes beside the checkout; the parts that need them are left out if they are missing."""

Z_95: Final = 1.959964


@dataclass(frozen=True)
class Options:
    """Options of a run; ``started`` is its start on the monotonic clock, s."""

    out: Path
    quick: bool
    shared: Path
    seed: int
    started: float = field(default_factory=time.monotonic)


@dataclass(frozen=True)
class Claim:
    """An expected result of an experiment, whether it holds, and the figures that show it."""

    text: str
    holds: bool
    figures: str


def read_options(description: str, arguments: Sequence[str] | None = None) -> Options:
    """Parse an experiment's command line."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, default=OUT, metavar="DIR", help="folder to write (default: data/experiments)"
    )
    parser.add_argument("--quick", action="store_true", help="a small run of less than a minute, to test the script")
    parser.add_argument(
        "--shared",
        type=Path,
        default=SHARED,
        metavar="DIR",
        help="folder of real frames and scanned meshes (default: shared, beside the checkout)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of all random numbers (default: %(default)s)"
    )
    given = parser.parse_args(arguments)
    return Options(out=given.out, quick=given.quick, shared=given.shared, seed=given.seed)


def write_experiment(
    options: Options,
    name: str,
    *,
    title: str,
    figures: Mapping[str, Any],
    claims: Sequence[Claim],
    tables: Sequence[str],
    picture: Figure,
    notes: Sequence[str] = (),
) -> None:
    """Write an experiment's JSON, Markdown and picture, and print their paths on stderr."""
    ran = {
        "date": datetime.date.today().isoformat(),
        "commit": commit(),
        "machine": machine_class(),
        "version": __version__,
        "quick": options.quick,
        "seed": options.seed,
        "minutes": round((time.monotonic() - options.started) / 60, 1),
    }
    document = {"experiment": name, "title": title, "ran": ran, "claims": [asdict(c) for c in claims], **figures}
    lines = [f"# {title}", "", _ran_line(ran), "", *_joined(tables)]
    lines += [f"- {'Holds' if c.holds else '**Does not hold**'}: {c.text} ({c.figures})." for c in claims]
    lines += ["", *notes] if notes else []
    write_figure(options.out / f"{name}.png", picture, dots_per_inch=80)
    write_text(options.out / f"{name}.md", "\n".join([*lines, "", f"![{title}]({name}.png)", ""]))
    write_json(options.out / f"{name}.json", document)
    print(f"written: {options.out / name}.json, .md, .png", file=sys.stderr)


def _ran_line(ran: Mapping[str, Any]) -> str:
    """Describe the run in one line."""
    quick = "A quick run, too small to conclude anything from. " if ran["quick"] else ""
    return (
        f"{quick}{ran['date']}, commit {ran['commit']}, version {ran['version']}, {ran['machine']}, "
        f"{ran['minutes']:g} min, seed {ran['seed']}."
    )


def _joined(tables: Sequence[str]) -> list[str]:
    """Return tables as paragraphs of Markdown."""
    return [line for table in tables for line in (table, "")]


def commit() -> str:
    """Return the short name of the current commit, with a plus if the code or the instruments differ from it."""
    paths = ("dvrk_cmaes", "scripts", "data/instruments", "pyproject.toml")
    try:
        name = _git("rev-parse", "--short", "HEAD")
        return name + ("+" if _git("status", "--porcelain", "--", *paths) else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*arguments: str) -> str:
    """Return the output of a git command."""
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def machine_class() -> str:
    """Describe the machine: processor, cores, operating system, Python."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model na")]
        model = names[0] if names else model
    return f"{model}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"


def table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table."""
    cells = [[str(cell) for cell in row] for row in rows]
    lines = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in cells)])


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a rate (Wilson's score interval)."""
    if trials == 0:
        return 0.0, 1.0
    rate, z2 = successes / trials, Z_95**2
    middle = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 / (1 + z2 / trials) * np.sqrt(rate * (1 - rate) / trials + z2 / (4 * trials**2))
    return float(max(middle - half, 0.0)), float(min(middle + half, 1.0))


def progress(label: str, done: int, total: int) -> None:
    """Print progress on stderr: on a terminal always in the same line, otherwise a line for every 20th item."""
    if sys.stderr.isatty():
        print(f"\r{label}: {done}/{total} ", end="\n" if done == total else "", file=sys.stderr, flush=True)
    elif done == total or done % 20 == 0:
        print(f"{label}: {done}/{total}", file=sys.stderr, flush=True)
