"""Count the words per sentence of the README and the reference pages, and the lines of prose of each page.

    python scripts/prose.py                 # a row a page, then all of them
    python scripts/prose.py --long          # also prints each sentence of more than 35 words

Code blocks, tables, headings and comments do not count. A sentence ends at a full stop, a question or exclamation mark,
or at the end of its paragraph or list item. A link counts as its text, code within a line as one word. Lines of prose
are all lines of a page that are not of a table, blank ones included.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
LONG: Final = 35
"""Words of a sentence, more than which are long."""

_SENTENCE_END: Final = re.compile(r"(?<=[.!?])[)\"*]*\s+(?=[A-Z0-9`*\"(\[<])")
_ITEM: Final = re.compile(r"^(?:[-*]|\d+\.) ", re.MULTILINE)


def pages() -> dict[str, str]:
    """Return the texts of the README and the reference pages by name."""
    paths = [ROOT / "README.md", *sorted((ROOT / "data" / "reference").glob("*.md"))]
    return {path.stem: path.read_text(encoding="utf-8") for path in paths}


def sentences(text: str) -> Iterator[str]:
    """Give the sentences of a page, without its code blocks, tables and headings."""
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"^(?:    |\||#).*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"!\[.*?\]\(.*?\)", "", text, flags=re.DOTALL)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]*`", "`code`", text)
    for paragraph in re.split(r"\n\s*\n", _ITEM.sub("\n\n", text)):
        if words := " ".join(paragraph.split()):
            yield from _SENTENCE_END.split(words)


def length(sentence: str) -> int:
    """Return the number of words of a sentence."""
    return sum(any(letter.isalnum() for letter in word) for word in sentence.split())


def lengths(text: str) -> list[int]:
    """Return the numbers of words of a page's sentences."""
    return [words for words in map(length, sentences(text)) if words]


def long_share(counted: Sequence[int]) -> float:
    """Return the share of sentences that are long, between 0 and 1."""
    return sum(words > LONG for words in counted) / max(len(counted), 1)


def lines_of_prose(text: str) -> int:
    """Return the number of lines of a page that are not of a table."""
    return sum(not line.startswith("|") for line in text.splitlines())


def report(texts: Mapping[str, str]) -> Iterator[str]:
    """Give a row for each page, and one for all."""
    yield f"{'page':20s} {'lines':>5s} {'sentences':>9s} {'median':>6s} {'long':>5s}"
    every = [number for text in texts.values() for number in lengths(text)]
    longest = max(map(lines_of_prose, texts.values()))
    rows = [(name, lines_of_prose(text), lengths(text)) for name, text in texts.items()]
    for name, lines, counted in [*rows, ("all, longest", longest, every)]:
        median = statistics.median(counted) if counted else 0.0
        yield f"{name:20s} {lines:5d} {len(counted):9d} {median:6.1f} {long_share(counted):5.1%}"


def main() -> int:
    """Print the counts; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--long", action="store_true", help="print the long sentences")
    options = parser.parse_args()
    texts = pages()
    print(*report(texts), sep="\n")
    if options.long:
        print(
            *(f"{name}: {one}" for name, text in texts.items() for one in sentences(text) if length(one) > LONG),
            sep="\n",
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
