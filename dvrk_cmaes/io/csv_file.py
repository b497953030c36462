"""CSV files from strangers: a header and rows of as many cells, or one line that says where it is wrong."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.short_text import shown

_LARGEST = 1_000_000_000  # bytes; an hour at 1 kHz has half of it

Rows = list[tuple[str, dict[str, str]]]


def read_csv_rows(path: str | Path, *, expected: str, text: str | None = None) -> tuple[list[str], Rows]:
    """Read a CSV's header and its rows; blank lines are passed over, and cells are stripped.

    Parameters
    ----------
    path
        The file, also for messages.
    expected
        What the file should be, for messages.
    text
        The file's text, where it was read already.

    Returns
    -------
    header, rows
        Names of the columns; of each row the words that begin a message about it, and its cells by column.

    Raises
    ------
    InputError
        Not readable, not CSV, a column twice, a row of another number of cells.
    """
    if text is None:
        text = read_text(path, expected=expected, largest=_LARGEST)
    reader = csv.reader(io.StringIO(text, newline=""))
    rows: Rows = []
    try:
        header = [name.strip() for name in next(reader, [])]
        for name, times in Counter(header).items():
            if times > 1:
                raise InputError(f"{path}: header: expected each column once, got {shown(name)} twice")
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            where = f"{path}: line {reader.line_num}"
            if len(cells) != len(header):
                raise InputError(f"{where}: expected {len(header)} cells as in the header, got {len(cells)}")
            rows.append((where, dict(zip(header, (cell.strip() for cell in cells), strict=True))))
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: expected {expected}, got no valid CSV ({error})") from None
    return header, rows


def number_in(where: str, column: str, cells: dict[str, str], unit: str = "") -> float:
    """Take a finite number from a row's column; ``unit`` is for the message. InputError beginning with ``where``."""
    try:
        value = float(cells[column])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        what = f"a finite number in {unit}" if unit else "a finite number"
        raise InputError(f"{where}: {column}: expected {what}, got {shown(cells[column])}")
    return value
