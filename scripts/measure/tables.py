"""Output of reports: tables as plain text, JSON and CSV."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import DvrkCmaesError

Report = Mapping[str, Sequence[Mapping[str, Any]]]
"""Rows of figures by title."""


def print_report(script: str, measure: Callable[[], Report], *, as_json: bool) -> int:
    """Measure and print the report as tables or JSON; return the exit code, that of an error with a line on stderr."""
    try:
        report = measure()
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
