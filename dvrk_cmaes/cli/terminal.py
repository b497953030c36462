"""Text output on stdout and stderr; lines on stdout are styled if it is a terminal."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterable
from typing import Any, NamedTuple

STATUS_STYLES = {"ok": "bold green", "doubtful": "bold yellow", "failed": "bold red"}

_LONGEST = 900  # characters of an error message


class Line(NamedTuple):
    """A line of output and its style on a terminal."""

    text: str
    style: str = ""


def prepare_streams() -> None:
    """Let stdout and stderr accept any file name; open the null device for one that is closed (``>&-``)."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (stays open until the program ends)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for file names that are not valid text


def discard_stdout() -> None:
    """Redirect stdout to the null device, so that unwritten output does not raise the same error again at exit."""
    with contextlib.suppress(OSError):  # stdout has no file descriptor, as in tests
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_error(message: str) -> None:
    """Print an error message as one line on stderr; if stderr cannot be written, only the exit code shows the error."""
    text = " ".join(message.split())
    if len(text) > _LONGEST:
        text = f"{text[: _LONGEST // 2]} ... {text[-_LONGEST // 2 :]}"
    with contextlib.suppress(OSError):
        note(text)


def warn(message: str, arm: str = "") -> None:
    """Print a warning about a result on stderr."""
    note(f"warning: {arm}: {message}" if arm else f"warning: {message}")


def note(message: str) -> None:
    """Print information on stderr, for commands whose stdout contains only the result."""
    text = f"dvrk-cmaes: {message}"
    if not sys.stderr.isatty():
        print(text, file=sys.stderr)
        return
    import shutil

    from dvrk_cmaes.cli.layout import fold

    print("\n".join(fold(text, shutil.get_terminal_size().columns)), file=sys.stderr)


def show(lines: Iterable[Line]) -> None:
    """Print lines on stdout, with their styles if it is a terminal."""
    if not sys.stdout.isatty():
        for line in lines:
            print(line.text)
        return
    from rich.console import Console
    from rich.text import Text

    from dvrk_cmaes.cli.layout import fold

    console = Console()
    for line in lines:
        for part in fold(line.text, console.width):
            console.print(Text(part, style=line.style), soft_wrap=True)


def answer(document: Any, lines: Iterable[Line], *, json: bool) -> None:
    """Print a document as JSON, or else the lines that say what it has."""
    from dvrk_cmaes.io.atomic import json_text

    if json:
        print(json_text(document), end="")
    else:
        show(lines)


def frames_text(frames: int) -> str:
    """Return a number of frames as text: ``1 frame``, ``2 frames``."""
    return f"{frames} frame{'' if frames == 1 else 's'}"
