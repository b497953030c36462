"""Output of tables as plain text and as CSV."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from accuracy_cases import Run


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


def write_features(path: Path, runs: Sequence[Run], truth: Sequence[Mapping[str, Any]]) -> None:
    """Write a CSV with one line for each run: case, status, reasons, features, and errors if the truth is known."""
    rows = [
        {
            "session": run.case.session,
            "frame": run.case.frame,
            "level": run.case.level,
            "kind": run.case.kind,
            "status": run.result["status"],
            "reasons": " | ".join(run.result["reasons"]),
            "seconds": run.result["seconds"],
            **run.features,
            **errors,
        }
        for run, errors in zip(runs, truth, strict=True)
    ]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
