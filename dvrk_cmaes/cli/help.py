"""``dvrk-cmaes help``: print the reference pages that are shipped with the package."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from dvrk_cmaes.cli.terminal import Line, show
from dvrk_cmaes.errors import InputError, nearest_first

_RELATIVE_LINK = re.compile(r"\[([^\]]*)\]\((?!\w+://)[^)]*\)")
_LONG = 240  # characters of a line of which only the sentences and cells with the words are printed


def help_topic(topic: str | None = None, /, *, search: str | None = None) -> int:
    """Print a reference page, or the options of a command; without a topic, list the topics.

    Pages have the width of the terminal, of $COLUMNS, or else 80 columns. Exit codes: 0 ok, 2 unknown topic.

    Examples
    --------
    ```
    dvrk-cmaes help results
    dvrk-cmaes help --search lag
    ```

    Parameters
    ----------
    topic
        Name of the page, or of a command.
    search
        Words, small or large, in any order: print the lines of pages that have all, of a long line the sentences with
        them, after their topic; of one topic if that is given.
    """
    pages = topic_pages()
    if topic is None and search is None:
        _print_markdown(_listing(pages))
        return 0
    if topic is not None and topic not in pages:
        from dvrk_cmaes.io.short_text import shown

        names = ", ".join(nearest_first(topic[:60], pages)[:3])
        raise InputError(f"help: expected a topic of `dvrk-cmaes help`, such as {names}, got {shown(topic[:40])}")
    if search is not None:
        show(_lines_with(search, pages if topic is None else {topic: pages[topic]}))
    elif topic is not None:
        _print_markdown(pages[topic].read_text(encoding="utf-8"))
    return 0


def topic_pages() -> dict[str, Path]:
    """Return the paths of the reference pages by topic, sorted by name."""
    from dvrk_cmaes.io.files import bundled_path

    return {path.stem: path for path in sorted(bundled_path("reference").glob("*.md"))}


def _listing(pages: Mapping[str, Path]) -> str:
    """Return a table of the topics and the titles of their pages, in Markdown."""
    titles = [path.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ") for path in pages.values()]
    rows = (f"| {topic} | {title} |" for topic, title in zip(pages, titles, strict=True))
    return "\n".join(["| TOPIC | what `dvrk-cmaes help TOPIC` prints |", "| --- | --- |", *rows])


def _lines_with(text: str, pages: Mapping[str, Path]) -> list[Line]:
    """Give the lines of pages that have all words of a text, in any case and order; InputError if none has."""
    words = text.casefold().split()
    found = [
        Line(f"{topic}: {_part_with(words, _RELATIVE_LINK.sub(lambda link: link[1], line).strip(' |'))}")
        for topic, path in pages.items()
        for line in path.read_text(encoding="utf-8").splitlines()
        if all(word in line.casefold() for word in words)
    ]
    if not found:
        raise InputError(f"help: --search: expected words of the pages, got {text[:40]!r}, which no line of them has")
    return found


def _part_with(words: Sequence[str], line: str) -> str:
    """Return a line, or the beginning of a long one and its sentences and cells that have one of the words."""
    first, *parts = [line] if len(line) <= _LONG else re.split(r"(?<=[.;|]) ", line)
    return " ... ".join([first, *(part for part in parts if any(word in part.casefold() for word in words))])


def _print_markdown(text: str) -> None:
    """Print formatted Markdown, with styles if stdout is a terminal, and relative links as text."""
    from rich.console import Console, ConsoleOptions, RenderResult
    from rich.markdown import CodeBlock, Markdown
    from rich.text import Text

    class Code(CodeBlock):
        """Code whose lines stay whole, so that a terminal wraps and copies them as one line each."""

        def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
            yield Text(str(self.text).rstrip(), no_wrap=True, overflow="ignore")

    class Page(Markdown):
        elements: ClassVar = {**Markdown.elements, "code_block": Code, "fence": Code}

    Console().print(Page(_RELATIVE_LINK.sub(r"\1", text)), crop=False)
