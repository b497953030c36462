"""The list of commands, as ``dvrk-cmaes`` and ``dvrk-cmaes --help`` print it, written without cyclopts and Rich.

Importing these two takes most of the time of printing a list that hardly changes. The text is the one that they print
(``tests/cli/test_overview.py`` compares them at several widths).
"""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from typing import Final

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

_OPTIONS: Final = {"--version": "Display application version."}
_ASKED: Final[tuple[list[str], ...]] = ([], ["--help"], ["-h"])
_NARROW: Final = 80
"""As in ``layout``, which has more to import."""
_LEAST: Final = 30
"""Columns below which cyclopts prints the list, by rules of its own."""
_DEFAULT_COLUMNS: Final = 80
_COLOUR, _PLAIN = "\x1b[36m", "\x1b[0m"


def print_overview(arguments: Sequence[str]) -> bool:
    """Print the list of commands or the version, if the arguments ask for that and stdout takes it.

    Returns False where this prints nothing: for other arguments, terminals without UTF-8, and very narrow ones.
    """
    if list(arguments) == ["--version"]:
        from dvrk_cmaes.config import __version__

        print(__version__, flush=True)
        return True
    width = _columns()
    if list(arguments) not in _ASKED or width < _LEAST or not _takes_lines():
        return False
    print("\n".join(overview(width, coloured=_is_coloured())), flush=True)
    return True


def overview(width: int, *, coloured: bool = False) -> list[str]:
    """Return the lines of the list of commands for a terminal of ``width`` columns."""
    about = [part for line in ABOUT.splitlines() for part in (_wrapped(line, width) or [""])]
    short = "--help -h" if width < _NARROW else "--help (-h)"
    entries = {**dict(sorted(SUMMARIES.items())), short: "Display this message and exit.", **_OPTIONS}
    lines = ["Usage: dvrk-cmaes COMMAND", "", *about, "", ""]
    if width < _NARROW:
        return [*lines, "Commands:", *_below_each_other(entries, width), ""]
    return [*lines, *_panel(entries, width, coloured=coloured)]


def _wrapped(text: str, width: int) -> list[str]:
    """Break a text between words."""
    return textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False)


def _below_each_other(entries: dict[str, str], width: int) -> Iterator[str]:
    """Give the lines of the entries with their texts below their names."""
    for name, text in entries.items():
        yield f"  {name}"
        for line in _wrapped(text, width - 6):
            yield " " * 6 + line


def _panel(entries: dict[str, str], width: int, *, coloured: bool) -> Iterator[str]:
    """Give the lines of the entries in two columns with a frame around them."""
    first = max(map(len, entries))
    second = width - first - 6
    yield "╭─ Commands " + "─" * (width - 13) + "╮"
    for name, text in entries.items():
        for number, line in enumerate(_wrapped(text, second)):
            label = f"{'' if number else name:<{first}}  "
            yield f"│ {_COLOUR + label + _PLAIN if coloured else label}{line:<{second}} │"
    yield "╰" + "─" * (width - 2) + "╯"


def _columns() -> int:
    """Return the width of the terminal, or that of text for files."""
    return shutil.get_terminal_size((_DEFAULT_COLUMNS, 25)).columns


def _is_terminal() -> bool:
    return sys.stdout.isatty()


def _is_coloured() -> bool:
    """Return whether stdout shows colours, by the rules of Rich."""
    return _is_terminal() and not os.environ.get("NO_COLOR") and os.environ.get("TERM", "") not in ("dumb", "unknown")


def _takes_lines() -> bool:
    """Return whether stdout takes the characters of a frame."""
    return (getattr(sys.stdout, "encoding", None) or "utf-8").lower().startswith("utf")
