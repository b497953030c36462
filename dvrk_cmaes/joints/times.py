"""Parsing of times to whole nanoseconds, and of the times of a session's images.

A column of times is in seconds. Times since 1970 in ms, us or ns are recognised by their magnitude, which a time in
seconds reaches only in 3,000 years.
"""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.csv_file import read_csv_rows
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.interpolation import NANOSECONDS

# for ns, us and ms: least magnitude of a time in this unit, and factor to ns
_UNITS = ((Decimal(10) ** 17, 1), (Decimal(10) ** 14, 10**3), (Decimal(10) ** 11, 10**6))
_LATEST = 2**62  # ns; about the year 2116
_IN_NAME = re.compile(r".*_(\d{9,10}\.\d{6,9})")


def parse_time(where: str, cell: object) -> int:
    """Parse a time exactly to ns; InputError if the cell is not a time."""
    try:
        time = Decimal(str(cell).strip())
        if time.is_finite() and abs(time) < _LATEST:
            factor = next((factor for least, factor in _UNITS if abs(time) >= least), NANOSECONDS)
            if abs(time * factor) < _LATEST:
                return round(time * factor)
    except ArithmeticError:  # not a number, or out of the range of Decimal
        pass
    raise InputError(f"{where}: time: expected a finite number of seconds, got {shown(cell)}")


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
    if not {"frame", "time"} <= set(header):
        raise InputError(f"{path}: header: expected columns frame and time, got {listed(header)}")
    times: dict[str, int] = {}
    for where, cells in rows:
        frame = cells["frame"]
        if not frame or frame in times:
            raise InputError(f"{where}: frame: expected each frame once, got {shown(frame)}{' again' if frame else ''}")
        times[frame] = parse_time(where, cells["time"])
    return times
