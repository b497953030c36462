"""Markdown for terminals of any width: code that fits, and lists in the place of tables that do not."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import groupby

from dvrk_cmaes.cli.layout import fold_code

_MARGIN = 2  # columns beside code
_RULE = re.compile(r"\|[ :|-]+\|\s*$")
_CELL = re.compile(r"(?<!\\)\|")


def fitted_markdown(text: str, width: int) -> str:
    """Return a page whose code and tables fit into ``width`` columns without broken words."""
    return "\n".join(line for kind, lines in _blocks(text.splitlines()) for line in _fitted(kind, lines, width))


def _blocks(lines: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Divide a page into code (indented by four), tables, and the rest."""

    def kind(line: str) -> str:
        return "code" if line.startswith("    ") else "table" if line.startswith("|") else "text"

    for name, group in groupby(lines, kind):
        yield name, list(group)


def _fitted(kind: str, lines: list[str], width: int) -> list[str]:
    """Return a block so that it fits."""
    if kind == "code":
        return [f"    {part}" for line in lines for part in fold_code(line[4:], width - _MARGIN)]
    if kind == "table" and _is_too_wide(lines, width):
        return list(_as_list(lines))
    return lines


def _is_too_wide(lines: Sequence[str], width: int) -> bool:
    """Whether rich breaks words of a table's cells at this width."""
    import io

    from rich.console import Console
    from rich.markdown import Markdown

    page = Markdown("\n".join(lines))
    words = []
    for columns in (width, 10_000):
        stream = io.StringIO()
        Console(file=stream, width=columns, force_terminal=False).print(page)
        words.append(set(stream.getvalue().split()))
    return not words[0] <= words[1]


def _as_list(lines: Sequence[str]) -> Iterator[str]:
    """Give a table as a list: an item for each row, with the heads of the columns before their cells."""
    head, *rows = (
        [cell.strip() for cell in _CELL.split(line.strip()[1:-1])] for line in lines if not _RULE.match(line)
    )
    yield ""
    for row in rows:
        first, *others = row
        yield f"- {first}" if first else "-"
        for name, cell in zip(head[1:], others, strict=False):
            if cell:
                yield f"    - {name}: {cell}" if name else f"    - {cell}"
    yield ""
