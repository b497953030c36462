"""A table of time-stamped joint readings: CSV with a column time (s) and one column a joint (rad; insertion in m).

A column frame, as in a session's joints.csv, is passed over. A blank cell is a reading that is not known.
"""

from __future__ import annotations

import csv
import io
import math
from decimal import Decimal, InvalidOperation
from pathlib import Path

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.joints import OUTER_JOINTS, WRIST_JOINTS
from dvrk_cmaes.io.shown import listed, shown
from dvrk_cmaes.timed_readings import NANOSECONDS, TimedReadings

_LARGEST = 1_000_000_000  # bytes; an hour at 1 kHz has half of it
_EXPECTED = "joint readings over time (CSV)"
_LATEST = 2**62  # ns; about the year 2116


def read_reading_table(path: Path) -> TimedReadings:
    """Read a table of readings over time.

    Raises
    ------
    InputError
        Not such a table, naming the line.
    """
    reader = csv.reader(io.StringIO(read_text(path, expected=_EXPECTED, largest=_LARGEST), newline=""))
    times: list[int] = []
    rows: list[list[float]] = []
    try:
        header = [name.strip() for name in next(reader, [])]
        joints = _joints(path, header)
        columns = [header.index(name) for name in joints]
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            where = f"{path}: line {reader.line_num}"
            if len(cells) != len(header):
                raise InputError(f"{where}: expected {len(header)} cells as in the header, got {len(cells)}")
            times.append(_time(where, cells[header.index("time")]))
            rows.append([_reading(where, name, cells[k]) for name, k in zip(joints, columns, strict=True)])
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: expected {_EXPECTED}, got no valid CSV ({error})") from None
    if not rows:
        raise InputError(f"{path}: expected {_EXPECTED}, got a header only")
    return TimedReadings.of(str(path), joints, times, rows)


def _joints(path: Path, header: list[str]) -> tuple[str, ...]:
    """Names of the columns of joints."""
    known = (*OUTER_JOINTS, *WRIST_JOINTS)
    joints = tuple(name for name in header if name not in ("time", "frame"))
    if "time" not in header or not joints:
        raise InputError(f"{path}: header: expected a column time (s) and columns of joints, got {listed(header, 8)}")
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{path}: header: expected each column once, got {shown(name)} twice")
    for name in joints:
        if name not in known:
            near = ", ".join(nearest_first(name[:60], known))
            raise InputError(f"{path}: header: unknown joint {shown(name)}; expected one of {near}")
    return joints


def _time(where: str, cell: str) -> int:
    """Time in ns, exactly as it is written."""
    try:
        time = Decimal(cell.strip()) * NANOSECONDS
        if time.is_finite() and abs(time) < _LATEST:
            return round(time)
    except InvalidOperation:
        pass
    raise InputError(f"{where}: time: expected a finite number of seconds, got {shown(cell)}")


def _reading(where: str, name: str, cell: str) -> float:
    """Value of a cell, NaN where it is blank."""
    if not cell.strip():
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {name}: expected a finite number, got {shown(cell)}")
    return value
