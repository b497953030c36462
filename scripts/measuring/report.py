"""Reports as tables, JSON and sections of data/measurements; folders of data; calls in worker processes."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, TypeVar

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.json_file import write_text

ROOT: Final = Path(__file__).resolve().parents[2]
"""The checkout."""
MEASUREMENTS: Final = ROOT / "data" / "measurements"
SHARED: Final = ROOT.parent / "shared"
"""Real frames and scanned meshes beside the checkout."""
SCANNED: Final = SHARED / "instruments" / "lnd_400006" / "lnd_400006.urdf"
"""The instrument of the shared frames."""

Report = Mapping[str, Sequence[Mapping[str, Any]]]
"""Rows of figures by title."""
Item = TypeVar("Item")


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


def today() -> str:
    """Return the date."""
    return datetime.now(UTC).date().isoformat()


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say where a report goes beside the terminal."""
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--record", metavar="NAME", help="add the tables to data/measurements/NAME.md")


def print_report(script: str, measure: Callable[[], Report], *, as_json: bool, kept: str | None = None) -> int:
    """Measure and print the report as tables or JSON; return the exit code, that of an error with a line on stderr.

    ``kept`` is the name of a file of data/measurements to which the tables are added.
    """
    try:
        path = None if kept is None else MEASUREMENTS / f"{kept}.md"
        if path is not None and not path.is_file():
            known = ", ".join(sorted(each.stem for each in MEASUREMENTS.glob("*.md") if each.stem != "index"))
            raise InputError(f"--record: expected one of {known}, got {kept!r}")
        report = measure()
        if path is not None:
            _record(report, shlex.join(["python", f"scripts/{script}", *sys.argv[1:]]), path)
    except DvrkCmaesError as error:
        print(f"{script}: {error}", file=sys.stderr)
        return error.exit_code
    if as_json:
        print(json.dumps(report, indent=1))
    else:
        for title, rows in report.items():
            show(title, rows)
    return 0


def _record(report: Report, command: str, path: Path) -> None:
    """Add the tables of a report to a file, each as a section that says when, where and how it was measured."""
    text = path.read_text(encoding="utf-8").rstrip("\n")
    for title, rows in report.items():
        measured = f"Measured {today()}, commit {commit()}, on {machine()}, by `{command}`."
        head, *lines = _cells(rows)
        text = f"{text}\n\n## {title}, {today()}, {commit()}\n\n{measured}\n\n{markdown(head, lines)}"
    write_text(path, f"{text}\n")


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out a table in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *rows])


def show(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows as a table with the names of the columns, under a title."""
    print(f"\n{title}")
    cells = _cells(rows)
    widths = [max(len(line[k]) for line in cells) for k in range(len(cells[0]))]
    for line in cells if rows else [["(none)"]]:
        print("  " + "  ".join(cell.rjust(width) for cell, width in zip(line, widths or [0], strict=True)))


def _cells(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Return the names of the columns, and the cells of each row."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    return [columns, *([_text(row.get(name)) for name in columns] for row in rows)]


def _text(value: Any) -> str:
    """Format a cell: ``-`` for None, three significant digits for small numbers."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
    if isinstance(value, list | tuple):
        return " ".join(_text(v) for v in value)
    return str(value)


def in_processes(call: Callable[..., Item], tasks: Sequence[tuple[Any, ...]], workers: int, label: str) -> list[Item]:
    """Call a function with the arguments of each task in worker processes with one thread each; return the results."""
    if workers == 1 or len(tasks) <= 1:
        return [call(*task) for task in tasks]
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # inherited by the workers, whose libraries read it when they are loaded
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _use_one_thread) as pool:
        futures = [pool.submit(call, *task) for task in tasks]
        for count, _ in enumerate(as_completed(futures), start=1):
            if count == len(tasks) or count % 20 == 0:
                print(f"{label}: {count}/{len(tasks)}", file=sys.stderr, flush=True)
        return [future.result() for future in futures]


def _use_one_thread() -> None:
    """Keep OpenCV in a worker process from using several threads."""
    import cv2

    cv2.setNumThreads(1)
