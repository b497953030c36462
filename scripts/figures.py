"""The figures of single frames in README.md and data/reference/accuracy.md, from one file, data/figures.json.

    python scripts/figures.py measure bundled clean easy medium hard    # sessions of dvrk-cmaes synth, see CONTRIBUTING
    python scripts/figures.py measure scanned SESSION... --instrument URDF
    python scripts/figures.py write

``measure`` replaces the rows of a set in the file, with the date, the machine and the commit; the sessions that it is
given name the rows, as ``real/easy`` or ``easy``. ``write`` writes the tables between the marked lines of both pages.
Of ``stated``, figures that were copied by hand, the file has the words of each document, and the date that they state.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from measure.accuracy.errors import error_report
from measure.cases import Measurement
from measure.tables import commit, machine

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.io.atomic import write_json, write_text

ROOT: Final = Path(__file__).resolve().parents[1]
FILE: Final = ROOT / "data" / "figures.json"
PAGES: Final = {"readme": ROOT / "README.md", "accuracy": ROOT / "data" / "reference" / "accuracy.md"}
PAPER: Final = {"real/easy": "0.932", "real/medium": "0.873"}
"""Overlap in the paper, of its own frames."""

_HEAD: Final = ("frames", "right mode", "jaw tips, median mm", "shaft axis, median deg")
_MADE: Final = ("clean", "easy", "medium", "hard")

Row = Mapping[str, Any]
Figures = Mapping[str, Any]


def number(value: float) -> str:
    """Format an error: two decimals below 1, else one."""
    return f"{value:.2f}" if round(value, 2) < 1 else f"{value:.1f}"


def cells(row: Row) -> list[str]:
    """Return the cells of a row: right mode, tips, shaft, worst joint, overlap, ok."""
    errors = [number(row[name]) if name in row else "" for name in ("tip_mm", "axis_deg", "joint_deg")]
    right = f"{row['right_mode']} of {row['frames']}" if "right_mode" in row else ""
    return [right, *errors, f"{row['iou']:.3f}", f"{row['ok']} of {row['frames']}"]


def markdown(head: tuple[str, ...], rows: list[list[str]]) -> str:
    """Lay out a table."""
    return "\n".join(f"| {' | '.join(row)} |" for row in [list(head), ["---"] * len(head), *rows])


def readme_table(figures: Figures) -> str:
    """Return the README's table: the bundled instrument, then the scanned one in each cell; the real frames."""
    bundled, scanned = (figures["frames"][name]["rows"] for name in ("bundled", "scanned"))
    rows = []
    for level in _MADE:
        pairs = zip(cells(bundled[level]), cells(scanned[level]), strict=True)
        one = [f"{first}, {second}" for first, second in pairs]
        rows.append([level, *one[:3], *one[4:]])
    for name, paper in PAPER.items():
        one = cells(scanned[name])
        rows.append([name.replace("/", ", "), "", "", "", f"{one[4]} (the paper: {paper})", one[5]])
    return f"{markdown((*_HEAD, 'overlap (IoU)', 'marked ok'), rows)}\n\n{measured(figures)}"


def accuracy_table(figures: Figures, name: str) -> str:
    """Return the table of a set for the page on accuracy."""
    chosen = figures["frames"][name]
    rows = []
    for level, row in chosen["rows"].items():
        one = cells(row)
        if level in PAPER:
            one[4] = f"{one[4]} (the paper: {PAPER[level]})"
        rows.append([level.replace("/", ", "), *one])
    head = (*_HEAD, "worst joint, median deg", "overlap (IoU)", "marked ok")
    return f"{markdown(head, rows)}\n\n{origin(chosen)}."


def origin(chosen: Row) -> str:
    """Return when, where and of which commit a set was measured."""
    return f"Measured {chosen['date']}, commit {chosen['commit']}, on {chosen['machine']}"


def measured(figures: Figures) -> str:
    """Return the line below the README's table."""
    first, second = (figures["frames"][name] for name in ("bundled", "scanned"))
    if origin(first) == origin(second):
        return f"{origin(first)}."
    return f"First: {origin(first).lower()}. Second, and real: {origin(second).lower()}."


def blocks(figures: Figures) -> dict[str, dict[str, str]]:
    """Return the text of each marked place of each page."""
    return {
        "readme": {"frames": readme_table(figures)},
        "accuracy": {name: accuracy_table(figures, name) for name in figures["frames"]},
    }


def with_blocks(page: str, texts: Mapping[str, str]) -> str:
    """Replace what is between the marked lines of a page; ValueError if a place is not marked."""
    for name, text in texts.items():
        begin, end = f"<!-- figures of {name}: made by scripts/figures.py -->", f"<!-- end of figures of {name} -->"
        pattern = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
        if not pattern.search(page):
            raise ValueError(f"expected the lines {begin} and {end}")
        page = pattern.sub(lambda _, b=begin, t=text, e=end: f"{b}\n{t}\n{e}", page)  # type: ignore[misc]
    return page


def rows_of(report: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the rows of a report of errors: counts of frames, and medians."""
    found = {}
    for row in report["sessions"]:
        counts = {name: round(row[name] * row["frames"]) for name in ("right_mode", "ok") if name in row}
        medians = {name: row[name][0] for name in ("tip_mm", "axis_deg", "joint_deg") if row.get(name)}
        found[row["session"]] = {"frames": row["frames"], **counts, **medians, "iou": row["iou"]}
    return found


def named(session: str) -> str:
    """Return the name of the row of a session's folder."""
    path = Path(session)
    return f"real/{path.name}" if path.parent.name == "real" else path.name


def measured_rows(sessions: Sequence[str], instrument: str, *, workers: int) -> dict[str, dict[str, Any]]:
    """Estimate the frames of sessions, and return a row for each."""
    rows = {}
    for session in sessions:
        given = Measurement([session], instrument, EstimateConfig(), None, workers, None)
        (row,) = rows_of(error_report(given.instrument, given.runs(truth=False))).values()
        rows[named(session)] = row
    return rows


def measure(options: argparse.Namespace) -> None:
    """Measure a set and replace it in the file."""
    rows = measured_rows(options.sessions, options.instrument, workers=options.workers)
    document = json.loads(FILE.read_text(encoding="utf-8"))
    document["frames"][options.set] = {
        "date": datetime.now(UTC).date().isoformat(),
        "machine": machine(),
        "commit": commit(),
        "rows": rows,
    }
    write_json(FILE, document)


def write() -> None:
    """Write the tables of both pages."""
    figures = json.loads(FILE.read_text(encoding="utf-8"))
    for name, texts in blocks(figures).items():
        write_text(PAGES[name], with_blocks(PAGES[name].read_text(encoding="utf-8"), texts))


def main() -> int:
    """Parse the options and run a command; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("measure", "write"))
    parser.add_argument("set", nargs="?", choices=("bundled", "scanned"), help="for measure: the set of figures")
    parser.add_argument("sessions", nargs="*", metavar="SESSION", help="for measure: session folders with golden.json")
    parser.add_argument("--instrument", default="lnd", metavar="NAME|URDF", help="instrument (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes (default: %(default)s)")
    options = parser.parse_args()
    if options.command == "measure":
        if options.set is None or not options.sessions:
            parser.error("measure: expected a set and sessions")
        measure(options)
    write()
    return 0


if __name__ == "__main__":
    sys.exit(main())
