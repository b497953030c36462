"""``dvrk-cmaes help``: lists the reference pages, prints one, and refuses unknown topics."""

from __future__ import annotations

import io

import pytest
from helpers.commands import run_command

from dvrk_cmaes.cli import main
from dvrk_cmaes.cli.help import topic_pages

TOPICS = sorted(topic_pages())


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_topics_are_listed_with_titles(capsys: pytest.CaptureFixture[str]) -> None:
    ran = run_command(capsys, "help")
    assert (ran.code, ran.err) == (0, "")
    first, *lines = ran.out.splitlines()
    assert first == "Topics of dvrk-cmaes help TOPIC"
    assert [line.split()[0] for line in lines] == TOPICS
    assert all(len(line) <= 120 and len(line.split()) > 3 for line in lines)


@pytest.mark.parametrize("topic", TOPICS)
def test_page_is_printed_unchanged_to_file(capsys: pytest.CaptureFixture[str], topic: str) -> None:
    ran = run_command(capsys, "help", topic)
    assert (ran.code, ran.err) == (0, "")
    assert ran.out == topic_pages()[topic].read_text(encoding="utf-8")


@pytest.mark.parametrize("topic", TOPICS)
def test_page_is_formatted_on_terminal(monkeypatch: pytest.MonkeyPatch, topic: str) -> None:
    terminal = Terminal()
    monkeypatch.setattr("sys.stdout", terminal)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("TERM", "dumb")
    assert main(["help", topic]) == 0
    text = terminal.getvalue()
    assert topic_pages()[topic].read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")[:40] in text
    assert not [mark for mark in ("](", "| ---", "<!--", "```", "\n#") if mark in text]


def test_unknown_topic_is_refused_with_nearest_name(capsys: pytest.CaptureFixture[str]) -> None:
    refusal = run_command(capsys, "help", "setings").refusal
    assert refusal.startswith("help: expected one of the topics settings, ")
    assert refusal.endswith(", got 'setings'")
    assert all(topic in refusal for topic in TOPICS)


@pytest.mark.parametrize("topic", ["../demo/README", "results.md", "", "x" * 10_000])
def test_path_as_topic_is_refused(capsys: pytest.CaptureFixture[str], topic: str) -> None:
    refusal = run_command(capsys, "help", topic).refusal
    assert len(refusal) < 400
