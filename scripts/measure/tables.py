"""Output of reports: tables as plain text, JSON and CSV, and sections of data/measurements."""

from __future__ import annotations

import argparse
import csv
import json
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, NamedTuple

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.atomic import write_text

ROOT: Final = Path(__file__).resolve().parents[2]
FOLDER: Final = ROOT / "data" / "measurements"

Report = Mapping[str, Sequence[Mapping[str, Any]]]
"""Rows of figures by title."""


class Section(NamedTuple):
    """A measured table: its title, the line that says when, where and how it was measured, and the cells of its rows.

    The first row is the head, the second one the line below it.
    """

    title: str
    measured: str
    rows: tuple[tuple[str, ...], ...]


def sections(page: str) -> Iterator[Section]:
    """Give the sections of a file of data/measurements."""
    for text in page.split("\n## ")[1:]:
        lines = text.splitlines()
        measured = next(line for line in lines if line.startswith("Measured "))
        rows = tuple(tuple(map(str.strip, line.strip("| ").split("|"))) for line in lines if line.startswith("|"))
        yield Section(lines[0], measured, tuple((*row, *[""] * (len(rows[0]) - len(row))) for row in rows))


def machine() -> str:
    """Return the processor's name and the number of cores."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    names = re.findall(r"^model name\s*:\s*(.*?)\s*$", text, re.MULTILINE)
    return f"{len(names)} cores of {names[0]}" if names else platform.machine()


def commit() -> str:
    """Return the commit of the checkout."""
    ran = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True)
    return ran.stdout.strip()


def recorded(name: str) -> Path:
    """Return a file of data/measurements; InputError if there is none of that name."""
    files = {path.stem: path for path in sorted(FOLDER.glob("*.md")) if path.stem != "index"}
    if name not in files:
        raise InputError(f"--record: expected one of {', '.join(files)}, got {name!r}")
    return files[name]


def record(report: Report, script: str, arguments: Sequence[str], path: Path) -> None:
    """Add the tables of a report to a file, each as a section that says when, where and how it was measured."""
    day = datetime.now(UTC).date().isoformat()
    command = shlex.join(["python", f"scripts/{script}", *arguments])
    text = path.read_text(encoding="utf-8").rstrip("\n")
    for title, rows in report.items():
        columns = list(dict.fromkeys(name for row in rows for name in row))
        cells = [columns, ["---"] * len(columns), *([_text(row.get(name)) for name in columns] for row in rows)]
        lines = "\n".join(f"| {' | '.join(line)} |" for line in cells)
        measured = f"Measured {day}, commit {commit()}, on {machine()}, by `{command}`."
        text = f"{text}\n\n## {title}, {day}, {commit()}\n\n{measured}\n\n{lines}"
    write_text(path, f"{text}\n")


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a script that say where its report goes, beside the terminal."""
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--record", metavar="NAME", help="add the tables to data/measurements/NAME.md")


def print_report(script: str, measure: Callable[[], Report], *, as_json: bool, kept: str | None = None) -> int:
    """Measure and print the report as tables or JSON; return the exit code, that of an error with a line on stderr.

    ``kept`` is the name of a file of data/measurements to which the tables are added.
    """
    try:
        if kept is not None:
            recorded(kept)
        report = measure()
        if kept is not None:
            record(report, script, sys.argv[1:], recorded(kept))
    except DvrkCmaesError as error:
        print(f"{script}: {error}", file=sys.stderr)
        return error.exit_code
    if as_json:
        print(json.dumps(report, indent=1))
    else:
        for title, rows in report.items():
            show(title, rows)
    return 0


def show(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows as a table with the names of the columns, under a title."""
    print(f"\n{title}")
    if not rows:
        print("  (none)")
        return
    columns = list(dict.fromkeys(name for row in rows for name in row))
    cells = [columns, *([_text(row.get(name)) for name in columns] for row in rows)]
    widths = [max(len(line[k]) for line in cells) for k in range(len(columns))]
    for line in cells:
        print("  " + "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))


def _text(value: Any) -> str:
    """Format a cell: ``-`` for None, three significant digits for small numbers."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
    if isinstance(value, list | tuple):
        return " ".join(_text(v) for v in value)
    return str(value)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as a CSV with all their columns."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
