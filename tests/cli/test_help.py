"""``dvrk-cmaes help``: lists the reference pages, prints one, and refuses unknown topics."""

from __future__ import annotations

import io
import re

import pytest
from helpers.commands import run_command
from rich.console import Console

from dvrk_cmaes.cli.app import COMMANDS, app, main
from dvrk_cmaes.cli.help import topic_pages
from dvrk_cmaes.cli.terminal import Line, error_console, note, show

TOPICS = sorted(topic_pages())
STYLES = re.compile(r"\x1b(?:\[[0-9;]*m|\]8;.*?\x1b\\)")


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def printed(monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], *, columns: int = 200) -> str:
    """What a command prints on a terminal of a number of columns, without styles."""
    terminal = Terminal()
    monkeypatch.setattr("sys.stdout", terminal)
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setattr(app, "console", Console())  # of this width: the app keeps its first one
    assert main(arguments) == 0
    return STYLES.sub("", terminal.getvalue())


def test_topics_are_listed_with_titles(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "140")
    ran = run_command(capsys, "help")
    assert (ran.code, ran.err) == (0, "")
    first, _, *lines = filter(None, map(str.strip, ran.out.splitlines()))
    assert first.split() == ["TOPIC", "what", "dvrk-cmaes", "help", "TOPIC", "prints"]
    assert [line.split()[0] for line in lines] == TOPICS
    assert all(len(line.split()) > 3 for line in lines)


@pytest.mark.parametrize("topic", TOPICS)
def test_page_has_eighty_columns_or_those_of_the_environment_in_a_pipe(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, topic: str
) -> None:
    for columns in (80, 100):
        monkeypatch.setenv("COLUMNS", str(columns))
        ran = run_command(capsys, "help", topic)
        assert (ran.code, ran.err) == (0, "")
        assert "\x1b" not in ran.out
        lines = [line.rstrip() for line in ran.out.splitlines()]
        commands = re.findall(r"^    (.*)$", topic_pages()[topic].read_text(encoding="utf-8"), re.MULTILINE)
        assert [line for line in lines if len(line) > columns and line not in commands] == []


@pytest.mark.parametrize("topic", TOPICS)
def test_page_is_formatted_on_terminal_and_its_commands_are_whole(monkeypatch: pytest.MonkeyPatch, topic: str) -> None:
    text = printed(monkeypatch, ("help", topic))
    page = topic_pages()[topic].read_text(encoding="utf-8")
    assert page.partition("\n")[0].removeprefix("# ")[:40] in text
    assert not [mark for mark in ("](", "| ---", "<!--", "```", "\n#") if mark in text]
    commands = re.findall(r"^    (dvrk-cmaes .*)$", page, re.MULTILINE)
    assert [command for command in commands if f"\n{command}\n" not in text] == []


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_are_listed_with_their_first_sentence_and_their_options_explained(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    first = " ".join(app[name].help.partition("\n\n")[0].split())
    text = printed(monkeypatch, (name, "--help"))
    assert first in text
    assert re.search(rf"{name} +{re.escape(first)}", printed(monkeypatch, ("--help",)))
    assert re.search(r"^\u2502[ *]+(--[a-z-]+ )+\S* *\u2502$", text, re.MULTILINE) is None
    assert [line for line in text.splitlines() if "dvrk-cmaes" in line and line.rstrip().endswith("\\")] == []


def test_help_of_a_command_is_its_help(monkeypatch: pytest.MonkeyPatch) -> None:
    assert printed(monkeypatch, ("help", "estimate")) == printed(monkeypatch, ("estimate", "--help"))


def test_topic_of_a_command_s_name_is_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "Live: following the instruments of a running robot" in printed(monkeypatch, ("help", "live"))


@pytest.mark.parametrize("page", [("--help",), *((name, "--help") for name in COMMANDS)], ids=" ".join)
def test_help_fits_eighty_columns_with_whole_examples(monkeypatch: pytest.MonkeyPatch, page: tuple[str, ...]) -> None:
    text = printed(monkeypatch, page, columns=80)
    assert [line for line in text.splitlines() if len(line) > 80] == []
    if len(page) > 1 and "```" in app[page[0]].help:
        for example in re.findall(r"```\n(.*?)\n```", app[page[0]].help, re.DOTALL):
            assert [line for line in example.splitlines() if not re.search(rf"{re.escape(line)} *\n", text)] == []


def test_lines_and_messages_are_wrapped_on_terminals_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr("sys.stdout", stream)
        monkeypatch.setattr("sys.stderr", stream)
        monkeypatch.setenv("COLUMNS", "60")
        monkeypatch.setenv("TERM", "xterm-256color")
        error_console.cache_clear()
        show([Line("word " * 30)])
        note("word " * 30)
        assert stream.getvalue().split().count("word") == 60
        assert (max(map(len, stream.getvalue().splitlines())) <= 60) == stream.isatty()


def test_unknown_topic_is_refused_with_nearest_name(capsys: pytest.CaptureFixture[str]) -> None:
    refusal = run_command(capsys, "help", "setings").refusal
    assert refusal.startswith("help: expected a topic of `dvrk-cmaes help`, such as settings, ")
    assert refusal.endswith(", got 'setings'")


def test_text_is_found_in_the_pages(capsys: pytest.CaptureFixture[str]) -> None:
    lines = run_command(capsys, "help", "--search", "RADTAN").out.splitlines()
    assert lines
    assert all("radtan" in line.lower() and line.partition(": ")[0] in TOPICS for line in lines)
    assert (
        run_command(capsys, "help", "--search", "rotation roll").out
        == run_command(capsys, "help", "--search", "roll  Rotation").out
    )
    assert run_command(capsys, "help", "--search", "no such wordz").refusal.startswith("help: --search: expected")
    assert all(
        line.startswith("live: ") for line in run_command(capsys, "help", "live", "--search", "a").out.splitlines()
    )


@pytest.mark.parametrize("topic", ["../demo/README", "results.md", "", "x" * 10_000])
def test_path_as_topic_is_refused(capsys: pytest.CaptureFixture[str], topic: str) -> None:
    refusal = run_command(capsys, "help", topic).refusal
    assert len(refusal) < 400
