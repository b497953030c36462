"""Common parts of the experiments: options and progress of a run, pictures, and the three files written.

An experiment writes OUT/NAME.json (all figures), OUT/NAME.md (a table and the claims) and OUT/NAME.png. The claims are
results that the paper reports or that we expect; each is written with the information whether it holds in this run.
"""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure
from measuring.report import commit, machine, today
from PIL import Image

from dvrk_cmaes.config import __version__
from dvrk_cmaes.io.json_file import write_json, write_text
from dvrk_cmaes.io.output import write_bytes

_COLOURS: Final = 64
"""Of a picture, which takes a third of its size with a palette."""


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


def write_experiment(
    options: Options,
    name: str,
    *,
    title: str,
    figures: Mapping[str, Any],
    claims: Sequence[Claim],
    table: str,
    picture: Figure,
    note: str,
) -> None:
    """Write an experiment's JSON, Markdown and picture, and print their paths on stderr."""
    ran = {
        "date": today(),
        "commit": commit(),
        "machine": machine(),
        "version": __version__,
        "quick": options.quick,
        "seed": options.seed,
        "minutes": round((time.monotonic() - options.started) / 60, 1),
    }
    document = {"experiment": name, "title": title, "ran": ran, "claims": [asdict(c) for c in claims], **figures}
    said = ", ".join(
        [*(str(ran[key]) for key in ("date", "machine")), f"commit {ran['commit']}", f"seed {ran['seed']}"]
    )
    lines = [
        f"# {title}",
        "",
        f"{said}, {ran['minutes']:g} min{', a quick run' if options.quick else ''}.",
        "",
        table,
        "",
    ]
    lines += [f"- {'Holds' if c.holds else '**Does not hold**'}: {c.text} ({c.figures})." for c in claims]
    _write_picture(options.out / f"{name}.png", picture)
    write_text(options.out / f"{name}.md", "\n".join([*lines, "", note, "", f"![{title}]({name}.png)", ""]))
    write_json(options.out / f"{name}.json", document)
    print(f"written: {options.out / name}.json, .md, .png", file=sys.stderr)


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def _write_picture(path: Path, figure: Figure) -> None:
    """Write a figure as a PNG with a palette and without transparency."""
    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=80)
    with Image.open(drawn) as opened:
        opened.convert("RGB").quantize(_COLOURS).save(small, format="PNG", optimize=True)
    write_bytes(path, small.getvalue())


def progress(label: str, done: int, total: int) -> None:
    """Print progress on stderr: on a terminal always in the same line, otherwise a line for every 20th item."""
    if sys.stderr.isatty():
        print(f"\r{label}: {done}/{total} ", end="\n" if done == total else "", file=sys.stderr, flush=True)
    elif done == total or done % 20 == 0:
        print(f"{label}: {done}/{total}", file=sys.stderr, flush=True)
