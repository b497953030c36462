"""Measure the speed of the renderer and of estimates. To be run by hand on a machine without other load.

    python scripts/bench.py render       ms for the loss terms of a candidate, compared with other renderers
    python scripts/bench.py estimate     seconds, silhouettes and rays a frame
    python scripts/bench.py stages       processor time of a frame by stage
    python scripts/bench.py calibrate    processor time of solving a session together, by stage
    python scripts/bench.py scale        time of the renderer by image and mesh size, frames a second by processes
    python scripts/bench.py track        ms a step of following an instrument; with --steps, memory after so many
    python scripts/bench.py page         bytes of a followed recording's page of 10,000 frames, time to load it
    python scripts/bench.py cores        speed of two threads and of two processes relative to one thread
    python scripts/bench.py checkouts    estimates, whole commands and a folder compared with another checkout

The default sessions and instrument are in the folder shared beside the checkout. Alternatives that are compared are run
alternately in one process; times are medians.
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
from bench_calibrate import calibrate_report
from bench_checkouts import checkouts_report
from bench_cores import cores_report
from bench_estimate import estimate_report, workers_report
from bench_page import page_report
from bench_render import render_report, scale_report
from bench_stages import stages_report
from bench_track import track_report

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.track.sight import KINDS

SHARED: Final = Path(__file__).resolve().parents[2] / "shared"
FRAMES: Final = ("made/clean", "made/easy", "made/medium", "made/hard", "real/easy", "real/medium")
SESSIONS: Final = [SHARED / "frames" / name for name in FRAMES]
SOLVED: Final = [SHARED / "frames" / "made" / name for name in ("easy", "medium", "hard")]
RECORDINGS: Final = [SHARED / "frames" / "video" / name for name in ("easy", "hard")]


def main() -> int:
    """Run a command and print its report; return the exit code."""
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
    """Report the command render."""
    return render_report(arguments.instrument, arguments.golden, repeats=3 if arguments.quick else arguments.repeats)


def _estimate(arguments: argparse.Namespace) -> dict[str, Any]:
    """Report the command estimate."""
    return estimate_report(arguments.instrument, arguments.sessions, frames=1 if arguments.quick else arguments.frames)


def _stages(arguments: argparse.Namespace) -> dict[str, Any]:
    """Report the command stages."""
    return stages_report(arguments.instrument, arguments.sessions, frames=1 if arguments.quick else arguments.frames)


def _calibrate(arguments: argparse.Namespace) -> dict[str, Any]:
    """Report the command calibrate."""
    sessions = arguments.sessions if arguments.sessions is not SESSIONS else SOLVED
    frames = 5 if arguments.quick else arguments.frames
    return calibrate_report(arguments.instrument, sessions, frames=frames, results=arguments.results)


def _scale(arguments: argparse.Namespace) -> dict[str, Any]:
    """Report the command scale."""
    report = scale_report(arguments.instrument, arguments.golden, repeats=2 if arguments.quick else arguments.repeats)
    workers = [1, 2] if arguments.quick else [n for n in (1, 2, 4, 8) if n <= max(os.cpu_count() or 1, 2)]
    frames = 2 if arguments.quick else arguments.frames
    return report | workers_report(arguments.instrument, arguments.golden, workers=workers, frames=frames)


def _cores(arguments: argparse.Namespace) -> dict[str, Any]:
    """Report the command cores."""
    return cores_report(arguments.instrument, arguments.golden, repeats=3 if arguments.quick else arguments.repeats)


def _track(arguments: argparse.Namespace) -> dict[str, Any]:
    """Report the command track."""
    sessions = arguments.sessions if arguments.sessions is not SESSIONS else RECORDINGS
    frames = 5 if arguments.quick else arguments.frames
    return track_report(
        arguments.instrument, sessions, frames=frames, steps=arguments.steps, evidence=arguments.evidence
    )


def _page(arguments: argparse.Namespace) -> dict[str, Any]:
    """Report the command page."""
    frames = 300 if arguments.quick else 10_000 if arguments.frames is None else arguments.frames
    return page_report(frames, 2 if arguments.quick else arguments.repeats)


def _checkouts(arguments: argparse.Namespace) -> dict[str, Any]:
    """Report the command checkouts."""
    if arguments.against is None:
        raise InputError("checkouts: expected --against DIR, the checkout to compare with")
    frames, repeats = (1, 1) if arguments.quick else (arguments.frames, arguments.repeats)
    return checkouts_report(
        arguments.instrument, arguments.sessions, other=arguments.against, frames=frames, repeats=repeats
    )


COMMANDS: Final = {
    "render": _render,
    "estimate": _estimate,
    "stages": _stages,
    "calibrate": _calibrate,
    "scale": _scale,
    "cores": _cores,
    "track": _track,
    "page": _page,
    "checkouts": _checkouts,
}


def _machine() -> dict[str, Any]:
    """Describe the machine: cores, load average over a minute, versions."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {"cores": os.cpu_count(), "load": load, "python": platform.python_version(), "numpy": np.__version__}


def _show(title: str, rows: Sequence[Mapping[str, Any] | str]) -> None:
    """Print rows as a table under a title, and rows of text below it."""
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
    """Format a cell: ``-`` for None, three significant digits for small numbers."""
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) and abs(value) < 1000 else str(value)


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=COMMANDS, help="what to measure")
    parser.add_argument(
        "--instrument",
        default=str(SHARED / "instruments" / "lnd_400006" / "lnd_400006.urdf"),
        metavar="NAME|URDF",
        help="bundled instrument or URDF",
    )
    parser.add_argument(
        "--golden",
        type=Path,
        default=SHARED / "frames" / "made" / "clean",
        metavar="SESSION",
        help="session with golden.json, for render, scale and cores",
    )
    parser.add_argument(
        "--sessions",
        type=Path,
        nargs="+",
        default=SESSIONS,
        metavar="SESSION",
        help="sessions, for estimate, stages, calibrate, track and checkouts",
    )
    parser.add_argument("--against", type=Path, metavar="DIR", help="for checkouts: the checkout to compare with")
    parser.add_argument(
        "--results", type=Path, metavar="DIR", help="for calibrate: results of batch (default: frames are estimated)"
    )
    parser.add_argument(
        "--evidence", choices=KINDS, nargs="+", default=["masks"], help="for track: evidence (default: %(default)s)"
    )
    parser.add_argument(
        "--steps", type=int, default=None, metavar="N", help="for track: steps after which memory is measured"
    )
    parser.add_argument(
        "--repeats", type=int, default=15, metavar="N", help="repetitions of each measurement (default: %(default)s)"
    )
    parser.add_argument(
        "--frames", type=int, default=None, metavar="N", help="largest number of frames of each session (default: all)"
    )
    parser.add_argument("--quick", action="store_true", help="few repetitions and frames, to test the script")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


if __name__ == "__main__":
    sys.exit(main())
