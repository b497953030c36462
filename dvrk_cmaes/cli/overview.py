"""The list of commands, as ``dvrk-cmaes`` and ``dvrk-cmaes --help`` print it, written without cyclopts and Rich.

Importing these two takes most of the time of printing a list that hardly changes.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from typing import Final

from dvrk_cmaes.cli.layout import NARROW, wrapped

SUMMARIES: Final = {
    "estimate": "Estimate the pose of an instrument in the camera, and its joint angles, from one mask or one image.",
    "segment": "Find the instrument in an image, or in each image of a folder.",
    "demo": "Estimate the bundled session, print the errors against the true poses, and write results and overlays.",
    "batch": "Estimate all frames of a session folder, and write a result and an overlay of each, tables and an HTML "
    "report.",
    "calibrate": "Calibrate a session: estimate the pose of the arm's base in the camera and the offset of each "
    "joint's readings.",
    "track": "Follow an instrument through the consecutive frames of a session or a video, by masks or images, and "
    "readings.",
    "live": "Follow the instruments of a running robot: images and readings from ROS topics, poses to ROS topics.",
    "export": "Write results in the formats of other programs.",
    "golden": "Record the poses of a session's frames, and compare later estimates with them.",
    "compare": "Compare two or more sets of poses of the same frames, by frame and in sum, without estimating again.",
    "consistency": "Measure how well the frames of a session agree, without true poses: the paper's Table I and "
    "further measures.",
    "pnp": "Estimate the poses of a session from image points and readings by PnP, as a baseline for comparisons.",
    "synth": "Write a synthetic session with known true poses, in the layout of a session folder.",
    "inspect": "Print what each file is taken for, what is read from it, and the rules that were applied to ambiguous "
    "content.",
    "import": "Convert a ROS recording (no ROS needed), a video with joint readings or a SurgSync clip to a session "
    "folder.",
    "help": "Print a reference page, or the options of a command; without a topic, list the topics.",
}
"""The commands, with the first sentence of what they do, so that listing them imports none of them."""

ABOUT: Final = """Pose and joint angles of da Vinci Research Kit instruments from one endoscope frame, on a CPU.

Try "dvrk-cmaes demo" first; "dvrk-cmaes help" lists the reference pages.
Exit codes: 0 ok, 1 failed, 2 wrong usage or input, 3 doubtful.
With --debug, any command shows where in the program an error was raised."""

_COLUMNS: Final = 80  # where stdout is no terminal


def print_overview(arguments: Sequence[str]) -> bool:
    """Print the list of commands or the version, if the arguments ask for that; False for other arguments."""
    if list(arguments) == ["--version"]:
        from dvrk_cmaes.config import __version__

        print(__version__, flush=True)
    elif list(arguments) in ([], ["--help"], ["-h"]):
        print("\n".join(overview(shutil.get_terminal_size((_COLUMNS, 25)).columns)), flush=True)
    else:
        return False
    return True


def overview(width: int) -> list[str]:
    """Return the lines of the list of commands for a terminal of ``width`` columns."""
    entries = dict(sorted(SUMMARIES.items())) | {
        "--help, -h": "Display this message and exit.",
        "--version": "Display application version.",
    }
    about = [part for line in ABOUT.splitlines() for part in wrapped(line, max(width, 1)) or [""]]
    lines = ["Usage: dvrk-cmaes COMMAND", "", *about, "", "Commands:"]
    indent = 6 if width < NARROW else 4 + max(map(len, entries))
    for name, text in entries.items():
        texts = wrapped(text, max(width - indent, 1))
        lines += [f"  {name}"] if width < NARROW else [f"  {name:<{indent - 2}}{texts.pop(0)}"]
        lines += [" " * indent + part for part in texts]
    return lines
