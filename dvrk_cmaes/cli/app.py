"""The command line app: its commands, and the conversion of every error to one line on stderr and an exit code."""

from __future__ import annotations

import errno
import os
import re
import sys
import traceback
import warnings
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from cyclopts import App, CycloptsError, MissingArgumentError, UnusedCliTokensError

from dvrk_cmaes.cli.help import topic_pages
from dvrk_cmaes.cli.terminal import INTERRUPTED, discard_stdout, prepare_streams, print_error
from dvrk_cmaes.errors import DvrkCmaesError, InputError, internal_error

_DEBUG = "--debug"

COMMANDS: Final = (
    "estimate",
    "segment",
    "demo",
    "batch",
    "calibrate",
    "track",
    "live",
    "export",
    "golden",
    "compare",
    "consistency",
    "pnp",
    "synth",
    "inspect",
    "import",
    "help",
)
"""The names of the commands, each of which is imported when it is used."""

_ABOUT: Final = """Pose and joint angles of da Vinci Research Kit instruments from one endoscope frame, on a CPU.

Try "dvrk-cmaes demo" first. Of files of your own, "dvrk-cmaes inspect FILE" says what is read and what to type next.

"dvrk-cmaes help" lists the reference pages; "dvrk-cmaes help tutorial" is the first to read.

Exit codes: 0 ok, 1 failed, 2 wrong usage or input, 3 doubtful.

With --debug, any command shows where in the program an error was raised.
"""

_FUNCTIONS: Final = {"import": "import_recording:import_recording", "help": "help:help_topic"}
"""Module and function of the commands that are not named as these."""

_NARROWEST = 20  # columns of a terminal
_LIMITS: Final = {
    errno.EAGAIN: "processes or threads (ulimit -u): fewer --workers and --threads",
    errno.EMFILE: "open files (ulimit -n)",
    errno.ENFILE: "open files of the system",
    errno.ENOMEM: "memory: fewer --workers, or a smaller image",
}
_IN_FILE: Final = "in the settings file (--config)"
_TOOL: Final = "columns, packages, root_link or tool of [[tool]] in session.toml"
_PICTURES: Final = "right, crop or stretch of [camera] in session.toml"
_RUNS: Final = ("batch", "calibrate", "track", "live", "golden")
_SESSIONS: Final = ("batch", "calibrate", "track", "golden", "pnp")


def _of(commands: Sequence[str], options: Sequence[str], instead: str) -> dict[str, str]:
    return {f"{command} {option}": instead for command in commands for option in options}


_REMOVED: Final[dict[str, str]] = {
    "--follow-links": "copies of the files in the folder",
    "--refine": "--preset card, or NLopt's bobyqa and sbplx by --search",
    "--shaft-radius": "the radius of the URDF's mesh",
    **_of(_RUNS, ("--preset",), f"refine.derivatives {_IN_FILE}"),
    **_of(_RUNS, ("--search",), f"search.method {_IN_FILE}"),
    **_of(_RUNS, ("--seed",), f"seed {_IN_FILE}"),
    **_of(_RUNS, ("--threads",), f"threads {_IN_FILE}"),
    **_of(_SESSIONS, ("--package-path", "--root-link", "--tool"), _TOOL),
    **_of(_SESSIONS, ("--camera-right", "--crop", "--stretch"), _PICTURES),
    **_of(("batch",), ("--shard", "--merge"), "`--frames` patterns with an --out each, or --scheduler"),
    "batch --retry-failed": "the same command: failed frames are estimated again",
    "calibrate --every": "--keyframes, or --frames with a pattern",
    "calibrate --instrument-candidates": "a calibration with each --instrument, and compare their leave-one-out",
    "compare --picture": "--out, whose page has the curves",
    "live --rehearse": "`dvrk-cmaes track --causal`",
    "export --to tracker": "--to csv; `dvrk-cmaes help problems` says how the tracker's start is made of it",
    "export --to joint-correction": "the offsets in session.json (`dvrk-cmaes help problems`)",
    "import --layout squeezed-side-by-side": "--layout side-by-side after `ffmpeg -i IN -vf scale=2*iw:ih OUT`",
    "import --layout squeezed-top-bottom": "--layout top-bottom after `ffmpeg -i IN -vf scale=iw:2*ih OUT`",
    "import --interlaced": "`ffmpeg -i IN -vf bwdif=send_field OUT`, which makes an image of each field",
    **_of(("track",), ("--resume", "--overwrite"), "the same command: what track wrote to the folder is replaced"),
    "track --columns": _TOOL,
    "track --frames": "--every, or a copy of the folder with these frames alone",
    "track --fps": f"track.frames_a_second {_IN_FILE}",
    **_of(("track",), ("--layout", "--video-start"), "`dvrk-cmaes import`"),
    **_of(("track",), ("--frame-offset", "--frame-step"), "times in joints.csv and images.csv, or `dvrk-cmaes import`"),
}
"""Options, and values of theirs, that were removed or are of other commands, and what is used instead."""


def _version() -> str:
    """Return the version of the package."""
    from dvrk_cmaes.config import __version__

    return __version__


app = App(name="dvrk-cmaes", help=_ABOUT, version=_version, suppress_keyboard_interrupt=False, help_format="markdown")
"""The app with all commands."""
for _name in COMMANDS:
    app.command(f"dvrk_cmaes.cli.{_FUNCTIONS.get(_name, f'{_name}:{_name}')}", name=_name)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line (``sys.argv`` by default) and return its exit code; no error is raised."""
    prepare_streams()
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    debug = _DEBUG in tokens
    if not os.environ.get("COLUMNS", "80").isdecimal() or int(os.environ.get("COLUMNS", "80")) < _NARROWEST:
        os.environ.pop("COLUMNS")  # a width of nothing, as of some terminals without one
    if tokens[:1] == ["help"] and tokens[1:] in [[name] for name in COMMANDS if name not in topic_pages()]:
        tokens = [tokens[1], "--help"]
    if not tokens or tokens[0] in ("--help", "-h"):
        for name in COMMANDS:
            app[name]  # imports the command, whose first sentence is listed
    with warnings.catch_warnings():
        if not (debug or sys.warnoptions):
            warnings.simplefilter("ignore")  # what a user has to know is said by the commands themselves
        try:
            empty = next((before for before, token in pairwise(["an argument", *tokens]) if not token), None)
            empty = empty or next((token[:-1] for token in tokens if re.fullmatch(r"--[\w-]+=", token)), None)
            if empty is not None:
                raise InputError(f"{empty}: expected a value, got an empty one (a variable that is not set?)")
            code = app(
                [token for token in tokens if token != _DEBUG],
                exit_on_error=False,
                print_error=False,
                result_action="return_value",
            )
            sys.stdout.flush()
            return int(code or 0)
        except (Exception, KeyboardInterrupt) as error:
            if debug:
                traceback.print_exc()
            return _said(error, tokens)


def _said(error: BaseException, tokens: Sequence[str]) -> int:
    """Print the line of an error of a command line, and return its exit code."""
    match error:
        case CycloptsError():
            error.verbose = False
            command = " ".join(["dvrk-cmaes", *(error.command_chain or ())])
            print_error(f"{(tokens and _removed(tokens)) or _missing(error, tokens) or error} (see {command} --help)")
            return InputError.exit_code
        case DvrkCmaesError():
            print_error(str(error))
            return error.exit_code
        case MemoryError():
            print_error("out of memory: try a smaller image, or fewer --threads")
        case KeyboardInterrupt():
            print_error("interrupted")
            return INTERRUPTED
        case BrokenPipeError():  # the reader closed stdout, e.g. ``| head``
            discard_stdout()
        case OSError() if error.errno in _LIMITS:
            print_error(f"a limit of the system is reached: {_LIMITS[error.errno]} ({error.strerror})")
        case RuntimeError() if "can't start new thread" in str(error):
            print_error(f"a limit of the system is reached: {_LIMITS[errno.EAGAIN]} ({error})")
        case OSError():  # errors of files are InputError already: this is stdout on a full disk
            print_error(f"{error.filename or 'stdout'}: {error.strerror}")
            if error.filename is not None:  # or a file name that the system refuses
                return InputError.exit_code
            discard_stdout()
        case _:
            print_error(f"{internal_error(error)}; {_DEBUG} shows where")
    return DvrkCmaesError.exit_code


def _removed(tokens: Sequence[str]) -> str | None:
    """Return the message for the first option, or value of one, that has another in its place; None without one."""
    words = [word for token in tokens for word in (token.split("=", 1) if token.startswith("--") else [token])]
    for name in (*words, *(" ".join(pair) for pair in pairwise(words))):
        if (instead := _REMOVED.get(f"{tokens[0]} {name}", _REMOVED.get(name))) is not None:
            return f"{name}: no option here; use {instead}"
    return None


def _missing(error: CycloptsError, tokens: Sequence[str]) -> str | None:
    """Return the message for a required argument that is missing, or for files of an unquoted pattern; else None."""
    if isinstance(error, UnusedCliTokensError) and any(map(os.path.exists, error.unused_tokens or ())):
        first = (error.unused_tokens or [""])[0]
        return f"unexpected {first}: quote a pattern ('a/*.png'); of one frame, name it by --mask or --image"
    if not isinstance(error, MissingArgumentError) or error.argument is None:
        return None
    name = error.argument.name
    if any(token == name or token.startswith(f"{name}=") for token in tokens):
        return None  # given, but without a value
    return f"{name}: missing; it is required"
