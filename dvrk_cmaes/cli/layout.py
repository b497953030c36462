"""Text for terminals of any width: lines are broken between words, and commands so that they can be pasted."""

from __future__ import annotations

import io
import re
import sys
import textwrap
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console, ConsoleOptions

NARROW = 80
"""Columns below which the texts of options stand below their names."""

_OPTION = re.compile(r" (?=--?[a-z])")
_COMMENT = re.compile(r"^(\s*\S.*?)\s{2,}(#.*)$")
_LINE_END = re.compile(r"(?: |\x1b\[[0-9;]*m)+$", re.MULTILINE)


def wrapped(text: str, width: int, first: str = "", rest: str = "") -> list[str]:
    """Break a text into lines of at most ``width`` between its words; ``first`` and ``rest`` begin the lines."""
    return textwrap.wrap(
        text, width, initial_indent=first, subsequent_indent=rest, break_long_words=False, break_on_hyphens=False
    )


def fold(text: str, width: int) -> list[str]:
    """Break a line between its words where it is wider than ``width``; what follows is indented by two more."""
    if len(text) <= width:
        return [text]
    lead = len(text) - len(text.lstrip())
    return wrapped(text, width, rest=" " * (lead + 2))


def fold_code(line: str, width: int) -> list[str]:
    """Break a line of code that is wider than ``width``: comments go before it, commands get backslashes.

    A command is broken before its options; other code stays as it is.
    """
    if len(line) <= width:
        return [line]
    lead = " " * (len(line) - len(line.lstrip()))
    commented = _COMMENT.match(line)
    if commented is not None:
        comment = wrapped(commented[2][1:].strip(), width - len(lead) - 2)
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
    return _LINE_END.sub(lambda end: end[0].replace(" ", ""), text)


class TrimmedOutput:
    """Stdout, whose lines end without spaces."""

    def write(self, text: str) -> int:
        """Write whole lines."""
        return sys.stdout.write(without_trailing_spaces(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stdout, name)


def trimmed_console() -> Console:
    """Return a console on stdout, whose lines end without spaces."""
    from rich.console import Console

    return Console(file=cast("IO[str]", TrimmedOutput()))


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
            yield from wrapped(_described(entry), console.width, first=" " * 6, rest=" " * 6)


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
