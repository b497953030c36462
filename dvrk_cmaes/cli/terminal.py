"""Writing for people: plain lines, with styles where the output is a terminal."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterable
from typing import NamedTuple

STATUS_STYLES = {"ok": "bold green", "doubtful": "bold yellow", "failed": "bold red"}


class Line(NamedTuple):
    """A line of output and its style on a terminal."""

    text: str
    style: str = ""


def prepare_streams() -> None:
    """Make stdout and stderr fit for all names of files, and for a program that was started without them (``>&-``)."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (until the program ends)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for names that are not text


def give_up_stdout() -> None:
    """Let go of what could not be written to stdout, so that it is not tried again at the end."""
    with contextlib.suppress(OSError):  # nothing below it, as in tests
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def complain(message: str) -> None:
    """Say on stderr, in one line, what is wrong; where even that cannot be written, the exit code must do."""
    with contextlib.suppress(OSError):
        print("dvrk-cmaes:", " ".join(message.split()), file=sys.stderr)


def warn(message: str) -> None:
    """Say on stderr what somebody should know of a result that is there all the same."""
    print("dvrk-cmaes: warning:", message, file=sys.stderr)


def note(message: str) -> None:
    """Say on stderr how a result came about that goes to stdout alone."""
    print("dvrk-cmaes:", message, file=sys.stderr)


def show(lines: Iterable[Line]) -> None:
    """Print lines on stdout, with their styles if that is a terminal."""
    if not sys.stdout.isatty():
        for line in lines:
            print(line.text)
        return
    from rich.console import Console
    from rich.text import Text

    console = Console()
    for line in lines:
        console.print(Text(line.text, style=line.style), soft_wrap=True)


def counted(frames: int) -> str:
    """Say how many frames."""
    return f"{frames} frame{'' if frames == 1 else 's'}"
