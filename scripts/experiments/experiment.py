"""What all experiments share: their options, what is said of where they ran, and the three files each one writes.

An experiment writes OUT/NAME.json (every figure), OUT/NAME.md (a table and its claims) and OUT/NAME.png. Its claims are
what the paper or we expect of it, each with whether it holds here: a claim that fails is written down like any other.
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

from dvrk_cmaes._version import __version__
from dvrk_cmaes.draw.figure import write_figure
from dvrk_cmaes.io.atomic import write_json, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT: Final = Path(__file__).resolve().parents[2]
OUT: Final = ROOT / "data" / "experiments"
SHARED: Final = ROOT.parent / "shared"
"""Real frames and scanned meshes, kept beside the checkout; what needs them is left out where they are not there."""

Z_95: Final = 1.959964


@dataclass(frozen=True)
class Options:
    """How an experiment is run."""

    out: Path
    quick: bool
    shared: Path
    seed: int
    started: float = field(default_factory=time.monotonic)


@dataclass(frozen=True)
class Claim:
    """Something that an experiment should show, whether it does, and the figures that say so."""

    text: str
    holds: bool
    figures: str


def read_options(description: str, arguments: Sequence[str] | None = None) -> Options:
    """Parse an experiment's command line."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=OUT, metavar="DIR", help="folder to write (data/experiments)")
    parser.add_argument("--quick", action="store_true", help="as little as shows that it runs: under a minute")
    parser.add_argument("--shared", type=Path, default=SHARED, metavar="DIR", help="real frames and scanned meshes")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of all random numbers")
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
    """Write an experiment's JSON, Markdown and picture; say on stderr where."""
    ran = {
        "date": datetime.date.today().isoformat(),
        "commit": _commit(),
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
    quick = "A quick run, too small to conclude anything from. " if ran["quick"] else ""
    return (
        f"{quick}{ran['date']}, commit {ran['commit']}, version {ran['version']}, {ran['machine']}, "
        f"{ran['minutes']:g} min, seed {ran['seed']}."
    )


def _joined(tables: Sequence[str]) -> list[str]:
    return [line for table in tables for line in (table, "")]


def _commit() -> str:
    """Short name of the commit that is checked out, with a plus if what is run differs from it."""
    what = ("dvrk_cmaes", "scripts", "data/instruments", "pyproject.toml")
    try:
        name = _git("rev-parse", "--short", "HEAD")
        return name + ("+" if _git("status", "--porcelain", "--", *what) else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*arguments: str) -> str:
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
    """Lay out a Markdown table."""
    cells = [[str(cell) for cell in row] for row in rows]
    lines = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in cells)])


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Give the 95 % confidence interval of a rate (Wilson's score interval)."""
    if trials == 0:
        return 0.0, 1.0
    rate, z2 = successes / trials, Z_95**2
    middle = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 / (1 + z2 / trials) * np.sqrt(rate * (1 - rate) / trials + z2 / (4 * trials**2))
    return float(max(middle - half, 0.0)), float(min(middle + half, 1.0))


def progress(label: str, done: int, total: int) -> None:
    """Say on stderr how far the work is; now and then, where that is a file."""
    if sys.stderr.isatty():
        print(f"\r{label}: {done}/{total} ", end="\n" if done == total else "", file=sys.stderr, flush=True)
    elif done == total or done % 20 == 0:
        print(f"{label}: {done}/{total}", file=sys.stderr, flush=True)
