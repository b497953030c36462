"""Tables of text, as commands print and pages show them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """Rows of cells under headings; the first cell of a row is its heading, on a page of ``frames`` a link to one."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    frames: bool = False

    def lines(self) -> Iterator[str]:
        """Yield the heading and the rows as lines of columns, the first to the left and the others to the right."""
        widths = [max(map(len, column)) for column in zip(self.head, *self.rows, strict=True)]
        for first, *others in (self.head, *self.rows):
            cells = (cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True))
            yield "  ".join([first.ljust(widths[0]), *cells]).rstrip()


def fixed(value: float | None, digits: int, *, sign: bool = False) -> str:
    """Format a number with some decimals, a missing or infinite one as a dash, zero without a sign."""
    if value is None or not math.isfinite(value):
        return "-"
    text = f"{value:{'+' if sign else ''}.{digits}f}"
    return text if text.strip("+-0.") else text.lstrip("+-")
