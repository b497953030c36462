"""Blocks of code in the documents: commands that are run as they are printed, and what they are to print."""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import NamedTuple

from helpers.commands import main

PROGRAM = re.compile(r"^(?:\$ )?(?:\.venv/bin/)?dvrk-cmaes ")
LEFT_OUT = "..."
"""A line of printed output that stands for others."""


class Block(NamedTuple):
    """A block of code under a heading."""

    section: str
    text: str

    @property
    def lines(self) -> list[str]:
        """The lines of a shell, those that are continued joined, without comments."""
        return [shlex.join(shlex.split(line, comments=True)) for line in self.text.replace("\\\n", " ").splitlines()]

    @property
    def commands(self) -> list[str]:
        """The lines that call the program, those that are continued joined, without comments."""
        lines = [line for line in self.text.replace("\\\n", " ").splitlines() if PROGRAM.match(line)]
        return [shlex.join(shlex.split(line.removeprefix("$ "), comments=True)) for line in lines]


class Output(NamedTuple):
    """What a command printed, and its exit code."""

    code: int
    out: str
    err: str


def blocks(page: str) -> Iterator[Block]:
    """Give the indented blocks of a page; those of a shell end at an empty line."""
    for section in re.split(r"\n##+ ", page):
        for match in re.finditer(r"(?:^    .*\n(?:\n+(?=    ))?)+", section, flags=re.MULTILINE):
            text = textwrap.dedent(match[0])
            parts = text.split("\n\n") if any(map(PROGRAM.match, text.splitlines())) else [text]
            yield from (Block(section.split("\n")[0], part) for part in parts)


def run(command: str) -> Output:
    """Run a command line of the program, in this process."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(shlex.split(PROGRAM.sub("", command)))
    return Output(code, out.getvalue(), err.getvalue())


def words(text: str) -> list[str]:
    """Give the lines without their numbers, which may change in the last digit, and without the files written."""
    lines = [re.sub(r"[-+]?\d+(\.\d+)?", "#", line).split() for line in text.splitlines() if line.strip()]
    return [" ".join(line) for line in lines if line[0] != "written:"]


def printed_parts(shown: str) -> list[list[str]]:
    """Give the words of what is shown of an output, in parts between lines that were left out."""
    parts: list[list[str]] = [[]]
    for line in words(shown):
        if line == LEFT_OUT:
            parts.append([])
        else:
            parts[-1].append(line)
    return [part for part in parts if part]


def has_in_order(output: Sequence[str], parts: Sequence[Sequence[str]]) -> bool:
    """Return whether an output has these runs of lines, each after the one before."""
    at = 0
    for part in parts:
        places = [k for k in range(at, len(output)) if list(output[k : k + len(part)]) == list(part)]
        if not places:
            return False
        at = places[0] + len(part)
    return True
