"""Measure the program on data with known truth: accuracy, what it states of its errors, speed, fleets, the benchmark.

    python scripts/measure.py estimate SESSION...    each frame by itself (as batch does)
    python scripts/measure.py calibrate SESSION...   sessions solved together; bases of several arms
    python scripts/measure.py track FOLDER...        recordings, or folders of them, that are followed
    python scripts/measure.py benchmark run FOLDER   worlds of every kind, by the tasks of data/reference/benchmark.md;
                                                     also draw, score
    python scripts/measure.py tips [SESSION]         tips of closed jaws on a board against the known ones; --images
    python scripts/measure.py pictures FRAMES        masks and poses found in images, of ../shared/frames
    python scripts/measure.py ablation               drawn frames solved by variants of the search
    python scripts/measure.py speed                  whole commands, with --against DIR those of another checkout, too
    python scripts/measure.py live                   poses a second over a websocket, and their age from image to pose
    python scripts/measure.py write                  writes the marked tables of pages; --check only compares them

To be run by hand. A session folder has camera.yaml, joints.csv, masks and the truth, golden.json (of several arms
golden_ARM.json); without truth only counts are printed. data/demo is such a folder, and `dvrk-cmaes synth` writes
others. All results are compared with the truth by one scorer, measuring/scorer.py. --keep DIR keeps results and reuses
them; delete the folder after a change of the program. Options after `--` go to the command that is measured, such as
`measure.py track FOLDER -- --evidence images --causal`. --falsify NAME (or all) also solves falsified copies of the
sessions: mistakes of users, other masks, wrong readings. Tables are added to a file of data/measurements by --record.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

from measuring import live
from measuring.ablation import ablation_report
from measuring.accuracy import accuracy_report
from measuring.benchmark import add_options, benchmark_report
from measuring.falsified import FALSIFIED
from measuring.pages import write_pages
from measuring.pictures import GROUPS, pictures_report
from measuring.report import SCANNED, SHARED, Report, add_output_options, print_report
from measuring.speed import speed_report
from measuring.tips import tips_report

FRAMES: Final = SHARED / "frames"


def main() -> int:
    """Run a command and print its report; return the exit code."""
    arguments, further = sys.argv[1:], []
    if "--" in arguments:
        place = arguments.index("--")
        arguments, further = arguments[:place], arguments[place + 1 :]
    options = _parser().parse_args(arguments)
    options.further = further
    if options.command == "write":
        return write_pages(check=options.check)
    report: Callable[[argparse.Namespace], Report] = options.report
    return print_report("measure.py", lambda: report(options), as_json=options.json, kept=options.record)


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)

    def command(name: str, report: Callable[[argparse.Namespace], Report], text: str) -> argparse.ArgumentParser:
        one = commands.add_parser(name, description=text, formatter_class=formatter)
        one.set_defaults(report=report)
        add_output_options(one)
        return one

    for name in ("estimate", "calibrate", "track"):
        one = command(name, accuracy_report, f"Solve session folders by {name} and compare with the truth.")
        one.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="session folders, or folders of some")
        one.add_argument(
            "--instrument", default="lnd", metavar="NAME|URDF", help="in the frames (default: %(default)s)"
        )
        one.add_argument("--workers", type=int, default=2, metavar="N", help="folders at once (default: %(default)s)")
        one.add_argument("--keep", type=Path, metavar="DIR", help="folder for results, which are reused")
        one.add_argument("--falsify", action="append", choices=[*FALSIFIED, "inputs", "all"], help="kind")
        one.add_argument("--table", action="store_true", help="print a row for each frame as well")
        one.add_argument("--fit", action="store_true", help="fit the constants of the tips' stated probability")
        one.add_argument("--set", metavar="NAME", help="replace this set of data/figures.json (bundled or scanned)")
    one = command("benchmark", benchmark_report, "Draw, solve and score the tasks of data/reference/benchmark.md.")
    add_options(one)
    one.add_argument("--workers", type=int, default=2, metavar="N", help="worlds at once (default: %(default)s)")
    one = command("pictures", pictures_report, "Find masks, and with --poses poses, in images of several laboratories.")
    one.add_argument(
        "frames", type=Path, nargs="?", default=FRAMES, help="folder of frames (default: ../shared/frames)"
    )
    one.add_argument("--groups", nargs="+", default=[*GROUPS], choices=[*GROUPS], help="default: all")
    one.add_argument("--most", type=int, metavar="N", help="number of a group's, at most (default: all)")
    one.add_argument("--poses", action="store_true", help="masks and poses as by estimate")
    one = command("ablation", ablation_report, "Solve drawn frames with truth by variants of the search.")
    one.add_argument("--seeds", type=int, nargs="+", default=[1, 2], metavar="N", help="of sets (default: 1 2)")
    one.add_argument("--frames", type=int, default=9, metavar="N", help="of a session (default: %(default)s)")
    one.add_argument("--variants", nargs="+", metavar="NAME", help="by their names in the table (default: all)")
    one.add_argument("--workers", type=int, default=2, metavar="N", help="sessions at once (default: %(default)s)")
    one.add_argument("--keep", type=Path, required=True, metavar="DIR", help="folder for results, which are reused")
    one = command(
        "tips", tips_report, "Solve a session with known tips by calibrate, with its masks or by images alone."
    )
    one.add_argument("session", type=Path, nargs="?", default=FRAMES / "labs" / "berkeley", help="with truth.csv")
    one.add_argument("--images", action="store_true", help="by images and readings, without the session's masks")
    one = command("speed", speed_report, "Measure whole commands, on a machine without other load.")
    one.add_argument("--session", type=Path, default=FRAMES / "made" / "medium", help="session with masks")
    one.add_argument("--recording", type=Path, default=FRAMES / "video" / "easy", help="recording with masks")
    one.add_argument("--instrument", default=str(SCANNED), metavar="NAME|URDF")
    one.add_argument("--against", type=Path, metavar="DIR", help="another checkout, measured in turns")
    one.add_argument("--repeats", type=int, default=12, metavar="N", help="runs of a command (default: %(default)s)")
    one = command("live", live.live_report, live.__doc__ or "")
    one.add_argument("--instrument", default=str(SCANNED), metavar="NAME|URDF")
    live.add_options(one)
    one = commands.add_parser("write", description="Write the marked tables of README.md and data/reference.")
    one.add_argument("--check", action="store_true", help="only say which are not as their files say; exit code 1")
    return parser


if __name__ == "__main__":
    sys.exit(main())
