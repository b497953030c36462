"""Text for people fits a terminal of 80 columns, and at 60 no word is broken; examples can be pasted."""

from __future__ import annotations

import io
import re
import shlex
from functools import cache

import pytest

from dvrk_cmaes.cli import main
from dvrk_cmaes.cli.app import app
from dvrk_cmaes.cli.help import topic_pages
from dvrk_cmaes.cli.layout import fold, fold_code, without_trailing_spaces
from dvrk_cmaes.cli.terminal import Line, note, show

COMMANDS = [name for name in app if not name.startswith("-")]
PAGES = [
    ("--help",),
    *((name, "--help") for name in COMMANDS),
    ("golden", "record", "--help"),
    ("golden", "check", "--help"),
    *(("help", topic) for topic in sorted(topic_pages())),
    ("help",),
]
STYLES = re.compile(r"\x1b(?:\[[0-9;]*m|\]8;.*?\x1b\\)")
FRAMES = re.compile(r"[\u2500-\u257f•]|(?<=\s)\\(?=\s)")


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@cache
def printed(arguments: tuple[str, ...], columns: int) -> str:
    """Give what a command prints on a terminal of a number of columns, without styles."""
    terminal = Terminal()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stdout", terminal)
        patch.setenv("COLUMNS", str(columns))
        patch.setenv("TERM", "xterm-256color")
        assert main(arguments) == 0
    return STYLES.sub("", terminal.getvalue())


def words_of(text: str) -> set[str]:
    return {word.rstrip(":,") for word in FRAMES.sub(" ", text).split()}


@pytest.mark.parametrize("arguments", PAGES, ids=" ".join)
@pytest.mark.parametrize("columns", [80, 60])
def test_page_fits_without_broken_words(arguments: tuple[str, ...], columns: int) -> None:
    lines = printed(arguments, columns).splitlines()
    assert [line for line in lines if len(line) > columns] == []
    assert [line for line in lines if line.endswith(" ")] == []
    wide = printed(arguments, 400)
    assert words_of("\n".join(lines)) - words_of(wide) - {"-h"} == set()


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_has_a_text(command: str) -> None:
    lines = printed((command, "--help"), 60).splitlines()
    named = [number for number, line in enumerate(lines) if re.match(r"  [-A-Z]", line) and ":" not in line]
    assert [lines[number] for number in named if not lines[number + 1].startswith("      ")] == []


@pytest.mark.parametrize("command", ["batch", "calibrate", "track", "golden record"])
def test_argument_comes_before_all_options(command: str) -> None:
    lines = printed((*command.split(), "--help"), 60).splitlines()
    assert next(line for line in lines if re.match(r"  [-A-Z]", line)).strip() == "SESSION"


def test_what_estimate_requires_is_marked() -> None:
    entries = re.split(r"\n  (?=--)", printed(("estimate", "--help"), 60))
    required = {entry.split()[0] for entry in entries if "required]" in " ".join(entry.split())}
    assert required == {"--mask", "--image", "--joints", "--camera"}


def test_examples_can_be_pasted() -> None:
    text = printed(("estimate", "--help"), 80)
    example = re.search(r"^ (dvrk-cmaes estimate --mask.*?[^\\])$", text, re.MULTILINE | re.DOTALL)
    assert example is not None
    tokens = shlex.split(example[1].replace("\\\n", " "))
    assert tokens[:3] == ["dvrk-cmaes", "estimate", "--mask"]
    assert tokens[-2:] == ["--out", "x"]


def test_help_of_a_command_is_its_help() -> None:
    expected = printed(("estimate", "--help"), 80)
    assert printed(("help", "estimate"), 80) == expected


def test_topic_of_a_command_s_name_is_the_page() -> None:
    assert "Live: following the instruments of a running robot" in printed(("help", "live"), 100)


def test_wide_code_is_continued_and_its_comment_goes_before_it() -> None:
    line = "dvrk-cmaes estimate ... --session session.json --out again   # starts there, searches if need be"
    assert fold_code(line, 40) == [
        "# starts there, searches if need be",
        "dvrk-cmaes estimate ... \\",
        "  --session session.json --out again",
    ]
    assert fold_code(line, 100) == [line]
    assert fold_code("x = [1, 2, 3, 4, 5, 6]", 10) == ["x = [1, 2, 3, 4, 5, 6]"]


def test_wide_line_is_folded_between_words_and_indented() -> None:
    assert fold("  one two three four-five", 14) == ["  one two", "    three", "    four-five"]
    assert fold("short", 80) == ["short"]


def test_spaces_at_line_ends_go_and_styles_stay() -> None:
    assert without_trailing_spaces("a \\  \x1b[0m \x1b[1m  \n b  ") == "a \\\x1b[0m\x1b[1m\n b"


def test_lines_and_messages_are_folded_on_terminals_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "word " * 30 + "end"
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr("sys.stdout", stream)
        monkeypatch.setattr("sys.stderr", stream)
        monkeypatch.setenv("COLUMNS", "60")
        monkeypatch.setenv("TERM", "xterm-256color")
        show([Line(text)])
        note(text)
        longest = max(map(len, stream.getvalue().splitlines()))
        assert (longest <= 60) == stream.isatty()
        assert stream.getvalue().split().count("word") == 60
