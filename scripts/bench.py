"""Measure the speed of the renderer, of estimates, folders and pages. By hand, on a machine without other load.

    python scripts/bench.py kernel       us a silhouette by size and mesh, beside other renderers; its share of a frame
    python scripts/bench.py estimate     seconds, silhouettes and rays a frame
    python scripts/bench.py stages       processor time of a frame by stage
    python scripts/bench.py calibrate    processor time of solving a session together, by stage
    python scripts/bench.py scale        time of the renderer by image and mesh size, frames a second by processes
    python scripts/bench.py track        ms a step of following an instrument; with --steps, memory after so many
    python scripts/bench.py steps        the time of each step of a running tracker, and what the longest did
    python scripts/bench.py page         bytes of a followed recording's page of 10,000 frames, time to load it
    python scripts/bench.py cores        speed of two threads and of two processes relative to one thread
    python scripts/bench.py checkouts    estimates with their errors, commands, folder, page, calibration and tests
                                         compared with another checkout
    python scripts/bench.py folder       frames a second of a folder by workers, and memory over time
    python scripts/bench.py many         a calibration by its number of frames, with all files written
    python scripts/bench.py live         poses a second over a websocket, and their age from image to pose

Each has options of its own: see `bench.py COMMAND --help`. The default sessions and instrument are in the folder shared
beside the checkout. Alternatives that are compared are run alternately in one process; times are medians.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from measure.bench import folder, live, many, steps
from measure.bench.calibrate import calibrate_report
from measure.bench.checkouts import checkouts_report
from measure.bench.cores import cores_report
from measure.bench.estimate import estimate_report, workers_report
from measure.bench.kernel import kernel_report, scale_report
from measure.bench.page import page_report
from measure.bench.stages import stages_report
from measure.bench.track import track_report
from measure.places import SCANNED, SHARED
from measure.tables import Report, add_output_options, print_report

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.track.view_segmenter import KINDS

FRAMES: Final = ("made/clean", "made/easy", "made/medium", "made/hard", "real/easy", "real/medium")
SESSIONS: Final = [SHARED / "frames" / name for name in FRAMES]
SOLVED: Final = [SHARED / "frames" / "made" / name for name in ("easy", "medium", "hard")]
RECORDINGS: Final = [SHARED / "frames" / "video" / name for name in ("easy", "hard")]


QUICK: Final[Mapping[str, Mapping[str, int]]] = {
    "kernel": {"repeats": 3, "frames": 2},
    "estimate": {"frames": 1},
    "stages": {"frames": 1},
    "calibrate": {"frames": 5},
    "scale": {"repeats": 2, "frames": 2},
    "track": {"frames": 5},
    "page": {"repeats": 2, "frames": 300},
    "cores": {"repeats": 3},
    "checkouts": {"repeats": 1, "frames": 1},
}
"""Numbers of repetitions and frames with --quick."""


def main() -> int:
    """Run a command and print its report; return the exit code."""
    options = _parser().parse_args()
    if getattr(options, "quick", False):
        vars(options).update(QUICK[options.command])

    def measure() -> Report:
        return {"machine": [_machine()], **COMMANDS[options.command](options)}

    return print_report("bench.py", measure, as_json=options.json, kept=options.record)


def _scale(options: argparse.Namespace) -> Report:
    """Report the command scale."""
    workers = [1, 2] if options.quick else [n for n in (1, 2, 4, 8) if n <= max(os.cpu_count() or 1, 2)]
    return scale_report(options.instrument, options.golden, repeats=options.repeats) | workers_report(
        options.instrument, options.golden, workers=workers, frames=options.frames
    )


def _checkouts(options: argparse.Namespace) -> Report:
    """Report the command checkouts."""
    if options.against is None:
        raise InputError("checkouts: expected --against DIR, the checkout to compare with")
    return checkouts_report(
        options.instrument,
        options.sessions,
        other=options.against,
        frames=options.frames,
        repeats=options.repeats,
        results=options.results,
        recording=options.recording,
        tests=options.tests,
    )


COMMANDS: Final[Mapping[str, Callable[[argparse.Namespace], Report]]] = {
    "kernel": lambda given: kernel_report(
        given.instrument, given.golden, given.sessions[0], repeats=given.repeats, frames=given.frames
    ),
    "estimate": lambda given: estimate_report(given.instrument, given.sessions, frames=given.frames),
    "stages": lambda given: stages_report(given.instrument, given.sessions, frames=given.frames),
    "calibrate": lambda given: calibrate_report(
        given.instrument, given.sessions, frames=given.frames, results=given.results
    ),
    "scale": _scale,
    "track": lambda given: track_report(
        given.instrument, given.sessions, frames=given.frames, steps=given.steps, evidence=given.evidence
    ),
    "page": lambda given: page_report(given.frames or 10_000, given.repeats),
    "cores": lambda given: cores_report(given.instrument, given.golden, repeats=given.repeats),
    "checkouts": _checkouts,
    "folder": folder.folder_report,
    "many": many.many_report,
    "live": live.live_report,
    "steps": steps.steps_report,
}
OWN_OPTIONS: Final = {"folder": folder, "many": many, "live": live, "steps": steps}
"""Modules of the commands that take other options than the rest."""


def _machine() -> dict[str, Any]:
    """Describe the machine: cores, load average over a minute, versions."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {"cores": os.cpu_count(), "load": load, "python": platform.python_version(), "numpy": np.__version__}


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in COMMANDS:
        module = OWN_OPTIONS.get(name)
        one = commands.add_parser(name, description=module.__doc__ if module else None, formatter_class=formatter)
        one.add_argument(
            "--instrument",
            default=str(SCANNED),
            metavar="NAME|URDF",
            help="bundled instrument or URDF",
        )
        add_output_options(one)
        if module is None:
            _add_options(one, {"calibrate": SOLVED, "track": RECORDINGS, "kernel": RECORDINGS}.get(name, SESSIONS))
        else:
            module.add_options(one)
    return parser


def _add_options(parser: argparse.ArgumentParser, sessions: list[Path]) -> None:
    """Add the options of the commands that have none of their own; ``sessions`` are the default."""
    parser.add_argument(
        "--golden",
        type=Path,
        default=SHARED / "frames" / "made" / "clean",
        metavar="SESSION",
        help="session with golden.json, for kernel, scale and cores",
    )
    parser.add_argument(
        "--sessions",
        type=Path,
        nargs="+",
        default=sessions,
        metavar="SESSION",
        help="sessions, for estimate, stages, calibrate, track and checkouts; for kernel: a recording",
    )
    parser.add_argument("--against", type=Path, metavar="DIR", help="for checkouts: the checkout to compare with")
    parser.add_argument(
        "--results",
        type=Path,
        metavar="DIR",
        help="for calibrate: results of batch (default: frames are estimated); for checkouts: those of --recording",
    )
    parser.add_argument(
        "--recording",
        type=Path,
        metavar="SESSION",
        help="for checkouts: session whose frames with --results are calibrated, repeated to 600",
    )
    parser.add_argument("--tests", action="store_true", help="for checkouts: measure all tests of both, too")
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


if __name__ == "__main__":
    sys.exit(main())
