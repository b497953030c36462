"""Read and write CSV files that consist of a header and rows with as many cells."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.short_text import shown

_FORMULA = ("=", "+", "-", "@", "\t", "\r")  # what formulas begin with
_LARGEST = 1_000_000_000  # bytes; an hour of readings at 1 kHz has half as many

Rows = list[tuple[str, dict[str, str]]]


def read_csv_rows(path: str | Path, *, expected: str, text: str | None = None) -> tuple[list[str], Rows]:
    """Read the header and the rows of a CSV file; blank lines are skipped and cells are stripped.

    Parameters
    ----------
    path
        The file, also for messages.
    expected
        What the file should be, for messages.
    text
        The file's text, if it has been read already.

    Returns
    -------
    header, rows
        Names of the columns; of each row the beginning of messages (file and line) and the cells by column.

    Raises
    ------
    InputError
        The file is not readable or not CSV, a column occurs twice, or a row has another number of cells.
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


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Format a header and rows of cells as the text of a CSV file; None as a blank cell, texts as by `cell_of`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([cell_of(name) for name in header])
    writer.writerows([cell_of(value) for value in row] for row in rows)
    return text.getvalue()


def cell_of(value: object) -> object:
    """Return the cell for a value: a text that a spreadsheet would take for a formula begins with an apostrophe.

    A frame's name may be ``=2+2``; numbers, also those given as texts, stay as they are.
    """
    if not isinstance(value, str) or not value.startswith(_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def number_in(where: str, column: str, cells: dict[str, str], unit: str = "") -> float:
    """Convert a cell to a finite number; InputError, which begins with ``where`` and names the unit, otherwise."""
    try:
        value = float(cells[column])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        what = f"a finite number in {unit}" if unit else "a finite number"
        raise InputError(f"{where}: {column}: expected {what}, got {shown(cells[column])}")
    return value
