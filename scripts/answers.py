"""Compare the answers of this checkout, or of the one of --checkout, with those of another one, to the last digit.

    python scripts/answers.py --against DIR                        all cases
    python scripts/answers.py --against DIR --only demo "track masks"
    python scripts/answers.py --against DIR --keep FOLDER          keep and reuse the other checkout's answers
    python scripts/answers.py --against DIR --largest-change 0.05  accept poses that change by less than 0.05 std

Each case runs commands of both checkouts, on the same inputs, with one thread and one process. All JSON and CSV files
that they write are compared value by value; times of computation and versions are left out. For each case the report
has the numbers of files, values and values that differ, the largest relative difference, changed statuses, reasons and
modes, and the largest change of a pose with its joints, in standard deviations as the other checkout states them.

Exit codes: 0 all answers are equal, or accepted; 1 answers differ; 2 wrong usage or input.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from answering.cases import CASES, Case
from answering.checkouts import Checkout, two_checkouts
from answering.compare import accepted, compare, read_answers
from measuring.report import ROOT, SCANNED

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.json_file import write_text

_COLUMNS: Final = ("files", "values", "differ", "largest relative", "largest change")


def main() -> int:
    """Run the cases and print the report; return the exit code."""
    arguments = _parser().parse_args()
    try:
        rows = _report(arguments)
    except InputError as error:
        print(f"answers.py: {error}", file=sys.stderr)
        return 2
    return 0 if all(row["accepted"] for row in rows.values()) else 1


def _report(arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Compare all chosen cases, and print each as soon as it is known; returns a row for each by name."""
    rows: dict[str, dict[str, Any]] = {}
    chosen = [case for case in CASES if arguments.only is None or case.name in arguments.only]
    with two_checkouts(arguments.checkout, arguments.against) as both:
        print("  ".join([f"{'case':<22s}", *(column.rjust(6) for column in _COLUMNS)]))
        for case in chosen:
            theirs = _kept(both[1], case, arguments.instrument, arguments.keep)
            row = compare(answers_of(both[0], case, arguments.instrument), theirs)
            row["accepted"] = accepted(row, arguments.largest_change)
            rows[case.name] = row
            _show(case.name, row)
    return rows


def _kept(checkout: Checkout, case: Case, instrument: str, keep: Path | None) -> dict[str, Any]:
    """Return a checkout's answers to a case: those kept for its commit and the same inputs, or else new ones, kept."""
    commit = None if keep is None else commit_of(checkout.folder)
    if keep is None or commit is None:
        return answers_of(checkout, case, instrument)
    path = keep / f"{case.name.replace('/', '-').replace(' ', '-')}.json"
    key = {"commit": commit, "case": _digest(case, instrument)}
    if path.is_file():
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["key"] == key:
            return dict(kept["answers"])
    answers = answers_of(checkout, case, instrument)
    keep.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps({"key": key, "answers": answers}))
    return answers


def commit_of(checkout: Path) -> str | None:
    """Return the commit of a checkout; None if it is none of git's, or has changes."""
    states = []
    for command in (["rev-parse", "HEAD"], ["status", "--porcelain"]):
        done = subprocess.run(["git", "-C", checkout, *command], capture_output=True, text=True, check=False)
        if done.returncode:
            return None
        states.append(done.stdout.strip())
    return None if states[1] else states[0]


def _digest(case: Case, instrument: str) -> str:
    """Return a digest of a case's commands and inputs."""
    found = hashlib.sha256(repr(_commands(case, instrument)).encode())
    with tempfile.TemporaryDirectory() as folder:
        case.write(Path(folder) / "inputs")
        for path in sorted(Path(folder).rglob("*.*")):
            found.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return found.hexdigest()


def _commands(case: Case, instrument: str) -> list[list[str]]:
    """Return the commands of a case with their instrument."""
    options = [] if case.bundled else ["--instrument", instrument]
    return [[*command, *options] for command in case.commands]


def answers_of(checkout: Checkout, case: Case, instrument: str) -> dict[str, Any]:
    """Run a case's commands in a new folder; return what they wrote, as `read_answers`, and their exit codes."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made).resolve()
        case.write(folder / "inputs")
        commands = _commands(case, instrument)
        codes = [checkout.run(command, folder, DVRK_CMAES_CACHE=checkout.cache) for command in commands]
        return {"exit codes": codes, **read_answers(folder)}


def _show(name: str, row: Mapping[str, Any]) -> None:
    """Print a case's figures, and below them what differs."""
    cells = [f"{row[column]:.2g}" if isinstance(row[column], float) else str(row[column]) for column in _COLUMNS]
    widths = [len(column) for column in _COLUMNS]
    verdict = "equal" if not row["differ"] else "accepted" if row["accepted"] else "DIFFERS"
    line = [f"{name:<22s}", *(cell.rjust(max(width, 6)) for cell, width in zip(cells, widths, strict=True)), verdict]
    print("  ".join(line), flush=True)
    for text in (*row["missing"], *row["verdicts"], *row["first"]):
        print(f"    {text}", flush=True)


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, required=True, metavar="DIR", help="the checkout to compare with")
    parser.add_argument(
        "--checkout", type=Path, default=ROOT, metavar="DIR", help="the checkout to compare (default: the script's own)"
    )
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="folder of the other checkout's answers, by its commit"
    )
    names = [case.name for case in CASES]
    parser.add_argument("--only", nargs="+", choices=names, metavar="NAME", help=f"cases: {', '.join(names)}")
    parser.add_argument(
        "--instrument",
        default=str(SCANNED.resolve()),
        metavar="NAME|URDF",
        help="bundled instrument or URDF, of the cases that are not of the bundled sessions",
    )
    parser.add_argument(
        "--largest-change",
        type=float,
        metavar="N",
        help="accept poses that change by less than N standard deviations, if status, reasons and modes agree",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
