"""Read and write CSV files of a header and rows with as many cells, and tables as commands print and pages show them.

Cells are separated by commas, or else by semicolons, tabs or blanks, as the first line has them. Between semicolons,
numbers may have decimal commas.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.short_text import is_number, shown

_FORMULA = ("=", "+", "-", "@", "\t", "\r")  # what formulas begin with
_LARGEST = 1_000_000_000  # bytes; an hour of readings at 1 kHz has half as many

_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")

Rows = list[tuple[str, dict[str, str]]]


def read_csv_rows(
    path: str | Path, *, expected: str, text: str | None = None, columns: Sequence[str] = ()
) -> tuple[list[str], Rows]:
    """Read the header and the rows of a CSV file; blank lines are skipped and cells are stripped.

    Parameters
    ----------
    path
        The file, also for messages.
    expected
        What the file should be, for messages.
    text
        The file's text, if it has been read already.
    columns
        Names of the columns, which count in place of those of the header; the file may then have no header.

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
    separator = separator_of(text)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=separator == " ")
    rows: Rows = []
    header = list(columns)
    try:
        for cells in reader:
            cells = [cell.strip() for cell in cells]
            if separator == " " and cells[-1:] == [""]:  # a blank at the end of the line
                cells = cells[:-1]
            if separator == ";":
                cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
            if not any(cells) and header:
                continue
            if not header or (reader.line_num == 1 and columns and not is_number(cells[0])):
                header = header or cells
                continue
            where = f"{path}: line {reader.line_num}"
            if len(cells) != len(header):
                said = "in the header" if not columns else "--columns says"
                raise InputError(f"{where}: expected {len(header)} cells as {said}, got {len(cells)}")
            rows.append((where, dict(zip(header, cells, strict=True))))
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: expected {expected}, got no valid CSV ({error})") from None
    if not columns and len(header) > 1 and all(is_number(cell) for cell in header):
        raise InputError(
            f"{path}: line 1: expected a header with the names of {len(header)} columns, got numbers: name them by "
            "--columns, such as --columns time,yaw,pitch,insertion,roll,wrist_pitch,wrist_yaw (- for one to leave out)"
        )
    for name, times in Counter(header).items():
        if times > 1 and (name != "-" or not columns):
            raise InputError(f"{path}: header: expected each column once, got {shown(name)} twice")
    return header, rows


def rows_by_frame(rows: Rows) -> dict[str, tuple[str, dict[str, str]]]:
    """Return rows by their cell ``frame``; InputError for one without a frame, or with that of an earlier row."""
    found: dict[str, tuple[str, dict[str, str]]] = {}
    for where, cells in rows:
        frame = cells["frame"]
        if not frame or frame in found:
            raise InputError(f"{where}: frame: expected each frame once, got {shown(frame)}{' again' if frame else ''}")
        found[frame] = where, cells
    return found


def separator_of(text: str) -> str:
    """Return what separates the cells of a CSV text, by its first line: a comma, semicolon, tab or blank."""
    first = text.lstrip("\ufeff").partition("\n")[0].strip()
    return next((mark for mark in (";", "\t", ",", " ") if mark in first), ",")


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
    is_formula = isinstance(value, str) and value.startswith(_FORMULA) and not is_number(value)
    return f"'{value}" if is_formula else value


def number_in(where: str, column: str, cells: dict[str, str], unit: str = "") -> float:
    """Convert a cell to a finite number; InputError, which begins with ``where`` and names the unit, otherwise."""
    value = float(cells[column]) if is_number(cells[column]) else math.nan
    if not math.isfinite(value):
        what = f"a finite number in {unit}" if unit else "a finite number"
        raise InputError(f"{where}: {column}: expected {what}, got {shown(cells[column])}")
    return value


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
