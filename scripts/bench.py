"""Measure how fast it is. Run by hand, on a quiet machine; never in the tests.

    python scripts/bench.py render       ms a candidate, loss terms out, beside peers that do the same work
    python scripts/bench.py estimate     seconds, silhouettes and rays a frame
    python scripts/bench.py scale        the renderer against image and mesh size, frames a second against workers
    python scripts/bench.py cores        what a second core is worth to two threads, and to two processes

Frames and meshes are those kept beside the checkout, or --sessions and --instrument. --json prints numbers for
programs, --quick does the least that shows that it works. What is compared is run in turns, in one process; times are
medians.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from bench_cores import cores_report
from bench_estimate import estimate_report, workers_report
from bench_render import render_report, scale_report

from dvrk_cmaes.errors import DvrkCmaesError, InputError

SHARED: Final = Path(__file__).resolve().parents[2] / "shared"
FRAMES: Final = ("made/clean", "made/easy", "made/medium", "made/hard", "real/easy", "real/medium")


def main() -> int:
    arguments = _parser().parse_args()
    try:
        report = {"machine": [_machine()], **COMMANDS[arguments.command](arguments)}
    except InputError as error:
        print(f"bench.py: {error}", file=sys.stderr)
        return 2
    except DvrkCmaesError as error:
        print(f"bench.py: {error}", file=sys.stderr)
        return 1
    if arguments.json:
        print(json.dumps(report, indent=1))
    else:
        for title, rows in report.items():
            _show(title, rows)
    return 0


def _render(arguments: argparse.Namespace) -> dict[str, Any]:
    return render_report(arguments.instrument, arguments.golden, repeats=3 if arguments.quick else arguments.repeats)


def _estimate(arguments: argparse.Namespace) -> dict[str, Any]:
    return estimate_report(arguments.instrument, arguments.sessions, frames=1 if arguments.quick else arguments.frames)


def _scale(arguments: argparse.Namespace) -> dict[str, Any]:
    report = scale_report(arguments.instrument, arguments.golden, repeats=2 if arguments.quick else arguments.repeats)
    workers = [1, 2] if arguments.quick else [n for n in (1, 2, 4, 8) if n <= max(os.cpu_count() or 1, 2)]
    frames = 2 if arguments.quick else arguments.frames
    return report | workers_report(arguments.instrument, arguments.golden, workers=workers, frames=frames)


def _cores(arguments: argparse.Namespace) -> dict[str, Any]:
    return cores_report(arguments.instrument, arguments.golden, repeats=3 if arguments.quick else arguments.repeats)


COMMANDS: Final = {"render": _render, "estimate": _estimate, "scale": _scale, "cores": _cores}


def _machine() -> dict[str, Any]:
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {"cores": os.cpu_count(), "load": load, "python": platform.python_version(), "numpy": np.__version__}


def _show(title: str, rows: Sequence[Mapping[str, Any] | str]) -> None:
    """Print rows under their title; those with the same names below each other."""
    print(f"\n{title}")
    tables = [row for row in rows if not isinstance(row, str)]
    columns = list(dict.fromkeys(name for row in tables for name in row))
    cells = [columns, *([_text(row.get(name)) for name in columns] for row in tables)]
    widths = [max(len(line[k]) for line in cells) for k in range(len(columns))]
    for line in cells if columns else []:
        print("  " + "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))
    for row in rows:
        if isinstance(row, str):
            print(f"  {row}")


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) and abs(value) < 1000 else str(value)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=COMMANDS)
    parser.add_argument("--instrument", default=str(SHARED / "instruments" / "lnd_400006" / "lnd_400006.urdf"))
    parser.add_argument("--golden", type=Path, default=SHARED / "frames" / "made" / "clean", help="session with truth")
    sessions = [SHARED / "frames" / name for name in FRAMES]
    parser.add_argument("--sessions", type=Path, nargs="+", default=sessions, help="sessions for estimate")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--frames", type=int, default=None, help="at most so many of each session")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", action="store_true")
    return parser


if __name__ == "__main__":
    sys.exit(main())
