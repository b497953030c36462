"""Parsing of times to whole nanoseconds, and of the times of a session's images.

A column of times is in seconds, or in the unit at the end of its name (``time_ms``). Times since 1970 in ms, us or ns
are recognised by their magnitude, which a time in seconds reaches only in 3,000 years. A date with a time of day is a
time, too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from decimal import Decimal
from pathlib import Path

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.csv_file import read_csv_rows, rows_by_frame
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.interpolation import NANOSECONDS

# for ns, us and ms: least magnitude of a time in this unit, and factor to ns
_UNITS = ((Decimal(10) ** 17, 1), (Decimal(10) ** 14, 10**3), (Decimal(10) ** 11, 10**6))
_LATEST = 2**62  # ns; about the year 2116
_IN_NAME = re.compile(r".*_(\d{9,10}\.\d{6,9})")


_COLUMN = re.compile(r"(time|timestamp|stamp|t)(?:_(s|sec|ms|us|ns|nsec))?", re.IGNORECASE)
_DATE = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?(Z|[+-]\d\d:?\d\d)?")
_FACTORS = {"s": NANOSECONDS, "sec": NANOSECONDS, "ms": 10**6, "us": 10**3, "ns": 1, "nsec": 1}
_SECONDS, _REST = ("sec", "secs"), ("nsec", "nanosec", "nsecs")
_FEW = 10  # times, whose steps do not determine the unit
_OF_MILLISECONDS = (5.0, 500.0)  # s; median step of times that may as well be in ms, of 2 to 200 a second


def time_column(path: str | Path, header: Sequence[str]) -> str | None:
    """Return the name of the column of times, such as time, timestamp or time_ms; None if there is none.

    Raises
    ------
    InputError
        There are several, and none is called time.
    """
    found = [name for name in header if _COLUMN.fullmatch(name)]
    if len(found) > 1 and "time" not in found:
        raise InputError(f"{path}: header: expected one column of times, or one called time, got {listed(found)}")
    return "time" if "time" in found else next(iter(found), None)


def parse_times(column: str, cells: Sequence[tuple[str, str]]) -> list[int | None]:
    """Parse the times in a column to ns, None for blank cells; with each cell comes the beginning of messages.

    Raises
    ------
    InputError
        A cell is not a time, or the column does not state its unit and whole numbers may be in seconds or in
        milliseconds.
    """
    unit = (_COLUMN.fullmatch(column) or ("", "", None))[2]
    factor = None if unit is None else _FACTORS[unit.lower()]
    times = [parse_time(where, cell, factor) if cell else None for where, cell in cells]
    known = [time for time in times if time is not None]
    if len(known) >= _FEW and len(set(known)) <= len(known) / 2:
        raise InputError(
            f"{cells[0][0]}: {column}: expected times that advance, got {len(set(known))} different ones in "
            f"{len(known)} rows, such as {cells[0][1]}: digits were lost where the table was written"
        )
    if factor is None and len(known) >= _FEW and all(cell.isdecimal() for _, cell in cells if cell):
        step = float(np.median(np.diff(known))) / NANOSECONDS
        if _OF_MILLISECONDS[0] <= step <= _OF_MILLISECONDS[1]:
            raise InputError(
                f"{cells[0][0]}: {column}: expected seconds, got whole numbers of which each is {step:g} more than the "
                f"one before: call the column {column}_ms if they are milliseconds, {column}_s if they are seconds"
            )
    return times


def parse_time(where: str, cell: object, factor: int | None = None) -> int:
    """Parse a time exactly to ns; InputError if the cell is not a time.

    ``factor`` is that of its unit to ns; by default it is found by the magnitude.
    """
    try:
        time = Decimal(str(cell).strip())
        if time.is_finite() and abs(time) < _LATEST:
            if factor is None:
                factor = next((factor for least, factor in _UNITS if abs(time) >= least), NANOSECONDS)
            if abs(time * factor) < _LATEST:
                return round(time * factor)
    except ArithmeticError:  # not a number, or out of the range of Decimal
        time_of_day = _of_date(str(cell).strip())
        if time_of_day is not None:
            return time_of_day
    raise InputError(f"{where}: time: expected a finite number of seconds, got {shown(cell)}")


def _of_date(text: str) -> int | None:
    """Parse a date and a time of day, as 2026-01-01T12:00:00.123Z, to ns since 1970; without a zone it is UTC."""
    match = _DATE.fullmatch(text)
    if match is None:
        return None
    try:
        moment = datetime.fromisoformat(f"{match[1]}T{match[2]}{match[4] or '+00:00'}")
    except ValueError:
        return None
    return round(moment.timestamp()) * NANOSECONDS + int(f"{match[3] or '0':0<9}")


def parse_stamp(where: str, stamp: object) -> int | None:
    """Return the time of a message's stamp, ns; None if it is none, or zero. InputError for numbers that are not whole.

    Its seconds are in ``sec`` or ``secs``, the rest in ``nsec``, ``nsecs`` or ``nanosec``.
    """
    if not isinstance(stamp, Mapping) or not any(name in stamp for name in _SECONDS):
        return None
    parts = [next((stamp[name] for name in names if name in stamp), 0) for names in (_SECONDS, _REST)]
    if not all(isinstance(part, int) and not isinstance(part, bool) and 0 <= part < 2**32 for part in parts):
        raise InputError(f"{where}: expected whole seconds and nanoseconds, got {shown(stamp)}")
    return int(parts[0]) * NANOSECONDS + int(parts[1]) or None


def time_in_name(name: str) -> int | None:
    """Parse the time at the end of an image's name, as in ``left_1755000000.123456789``, ns; None if there is none."""
    match = _IN_NAME.fullmatch(name)
    return None if match is None else parse_time(name, match[1])


def read_image_times(path: Path) -> dict[str, int]:
    """Read an images.csv (columns ``frame, time``) and return the time of each frame, ns.

    Raises
    ------
    InputError
        The table is not valid; the message names the file, the line and what was expected.
    """
    header, rows = read_csv_rows(path, expected="the times of images (images.csv)")
    column = time_column(path, header)
    if "frame" not in header or column is None:
        raise InputError(f"{path}: header: expected columns frame and time, got {listed(header)}")
    found = rows_by_frame(rows)
    parsed = parse_times(column, [(where, cells[column]) for where, cells in rows])
    return {
        frame: parse_time(where, cells[column]) if time is None else time
        for (frame, (where, cells)), time in zip(found.items(), parsed, strict=True)
    }
