"""Text for terminals of any width: lines are broken between words, and commands so that they can be pasted."""

from __future__ import annotations

import io
import re
import sys
import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console, ConsoleOptions

NARROW = 80
"""Columns below which the texts of options stand below their names."""

_OPTION = re.compile(r" (?=--?[a-z])")
_COMMENT = re.compile(r"^(\s*\S.*?)\s{2,}(#.*)$")
_LAST_STYLE = re.compile(r"\x1b\[[0-9;]*m$")
_LONGEST_STYLE = 40


def fold(text: str, width: int) -> list[str]:
    """Break a line between its words where it is wider than ``width``; what follows is indented by two more."""
    if len(text) <= width:
        return [text]
    lead = len(text) - len(text.lstrip())
    return textwrap.wrap(
        text,
        width,
        subsequent_indent=" " * (lead + 2),
        drop_whitespace=True,
        break_long_words=False,
        break_on_hyphens=False,
    )


def fold_code(line: str, width: int) -> list[str]:
    """Break a line of code that is wider than ``width``: comments go before it, commands get backslashes.

    A command is broken before its options; other code stays as it is.
    """
    if len(line) <= width:
        return [line]
    lead = " " * (len(line) - len(line.lstrip()))
    commented = _COMMENT.match(line)
    if commented is not None:
        comment = textwrap.wrap(
            commented[2][1:].strip(), width - len(lead) - 2, break_long_words=False, break_on_hyphens=False
        )
        return [*(f"{lead}# {part}" for part in comment), *fold_code(commented[1], width)]
    if not re.match(r"\s*(\S*dvrk-cmaes|pip|curl|ros2) ", line):
        return [line]
    lines, current = [], ""
    for part in _OPTION.split(line.strip()):
        if current and len(lead) + len(current) + len(part) + 3 > width:
            lines.append(f"{lead}{current} \\")
            current = f"  {part}"
        else:
            current = f"{current} {part}" if current else part
    return [*lines, f"{lead}{current}"]


def without_trailing_spaces(text: str) -> str:
    """Remove the spaces at the ends of lines, which would follow a pasted backslash; styles stay."""
    return "\n".join(_trimmed(line) for line in text.split("\n"))


def _trimmed(line: str) -> str:
    tail = ""
    while True:
        line = line.rstrip(" ")
        style = _LAST_STYLE.search(line, max(0, len(line) - _LONGEST_STYLE))
        if style is None:
            return line + tail
        tail = style[0] + tail
        line = line[: style.start()]


class TrimmedOutput(io.StringIO):
    """Stdout, whose lines end without spaces."""

    def write(self, text: str) -> int:
        """Write whole lines."""
        return sys.stdout.write(without_trailing_spaces(text))

    def flush(self) -> None:
        """Flush stdout."""
        sys.stdout.flush()

    def isatty(self) -> bool:
        """Whether stdout is a terminal."""
        return sys.stdout.isatty()

    def fileno(self) -> int:
        """Return the descriptor of stdout."""
        return sys.stdout.fileno()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """That of stdout."""
        return sys.stdout.encoding


class HelpFormatter:
    """The panels of ``--help``: two columns, and in less than 80 columns the text of an option below its name."""

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        """Print a panel."""
        if console.width >= NARROW:
            from cyclopts.help import DefaultFormatter

            DefaultFormatter()(console, options, panel)
            return
        if panel.entries:
            for line in self._lines(panel, console):
                console.print(line, highlight=False, markup=False, soft_wrap=True)
            console.print()

    def render_usage(self, console: Console, options: ConsoleOptions, usage: Any) -> None:
        """Print the line of usage, broken between words."""
        if usage:
            for line in fold(f"Usage: {_plain(usage).removeprefix('Usage: ')}", console.width):
                console.print(line, highlight=False, markup=False, soft_wrap=True)
            console.print()

    def render_description(self, console: Console, options: ConsoleOptions, description: Any) -> None:
        """Print what a command does."""
        if description:
            console.print(description)
            console.print()

    def _lines(self, panel: HelpPanel, console: Console) -> Iterator[str]:
        """Give the lines of a panel."""
        yield f"{_plain(panel.title)}:"
        for entry in panel.entries:
            yield f"  {' '.join(entry.display_labels_with_metavar)}"
            yield from textwrap.wrap(
                _described(entry),
                console.width,
                initial_indent=" " * 6,
                subsequent_indent=" " * 6,
                break_long_words=False,
                break_on_hyphens=False,
            )


def _described(entry: HelpEntry) -> str:
    """Return the text of an option with its choices and its default, and whether it is required."""
    parts = [_plain(entry.description)]
    if entry.choices:
        parts.append(f"[choices: {', '.join(entry.choices)}]")
    if entry.default is not None:
        parts.append(f"[default: {entry.default}]")
    if entry.required:
        parts.append("[required]")
    return " ".join(part for part in parts if part)


def _plain(text: Any) -> str:
    """Return the words of a text of the help, which may be styled."""
    if text is None:
        return ""
    if isinstance(text, str):
        return text
    from rich.console import Console

    console = Console(file=io.StringIO(), width=100_000, force_terminal=False, no_color=True, highlight=False)
    with console.capture() as captured:
        console.print(text, end="", soft_wrap=True)
    return " ".join(captured.get().split())
