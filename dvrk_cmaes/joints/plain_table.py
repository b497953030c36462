"""Large tables of times and joints that have numbers alone, read by columns: an hour at 1 kHz is 3.6 million rows."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.joints.rows import JointFile, TableRows

LEAST = 1_000_000
"""Bytes of a table from which on it is read by columns, if it can be."""

_CHUNK = 1 << 23  # bytes that are read at once
_NUMBERS = b"0123456789+-.eEnaN,\n"
_LATEST = 4_000_000_000  # s; larger times may be in another unit
_MOST_WIDTH, _DIGITS = 20, 9  # characters of a time, and its digits behind the point


def read_plain_table(path: str, data: bytes, names: Sequence[str]) -> JointFile | None:
    """Read a table whose header is ``time`` and joints; None for any other, which `read_joint_csv` reads or refuses.

    Times are exact to the nanosecond; a blank cell and ``nan`` are missing readings. ``names`` are those of the joints
    that are accepted.
    """
    begin = data.find(b"\n") + 1
    header = [name.strip() for name in data[:begin].removeprefix(b"\xef\xbb\xbf").decode("ascii", "replace").split(",")]
    joints = tuple(header[1:])
    if header[0] != "time" or not joints or len({*joints}) < len(joints) or not {*joints} <= {*names}:
        return None
    most = data.count(b"\n", begin) + 1
    times, values, count = np.empty(most, np.int64), np.empty((most, len(joints))), 0
    while begin < len(data):
        end = data.rfind(b"\n", begin, begin + _CHUNK) + 1 or len(data)
        found = _numbers(data[begin:end].replace(b"\r\n", b"\n").rstrip(b"\n") + b"\n", len(header))
        if found is None:
            return None
        more = len(found[0])
        times[count : count + more], values[count : count + more] = found
        begin, count = end, count + more
    rows = TableRows(path, joints, times[:count], values[:count])
    return JointFile(path, "joints.csv", rows, "message") if (np.diff(rows.times) > 0).all() else None


def _numbers(chunk: bytes, columns: int) -> tuple[NDArray[np.int64], Float64] | None:
    """Return times (N,), ns, and readings (N, J) of whole rows; None if a row is not of plain numbers."""
    if chunk.translate(None, _NUMBERS):
        return None
    while b",," in chunk:
        chunk = chunk.replace(b",,", b",nan,")
    chunk = chunk.replace(b",\n", b",nan\n")
    buffer = np.frombuffer(chunk, np.uint8)
    ends, commas = np.flatnonzero(buffer == ord("\n")), np.flatnonzero(buffer == ord(","))
    starts = np.concatenate([[0], ends[:-1] + 1])
    if len(commas) != len(ends) * (columns - 1):
        return None
    between = commas.reshape(len(ends), columns - 1)
    if (between[:, 0] < starts).any() or (between[:, -1] > ends).any():
        return None
    times = _times(buffer, starts, between[:, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # text that is no number
        try:
            cells = np.fromstring(chunk.replace(b"\n", b","), sep=",")
        except (DeprecationWarning, ValueError):
            return None
    if times is None or cells.size != len(ends) * columns:
        return None
    return times, cells.reshape(len(ends), columns)[:, 1:]


def _times(buffer: NDArray[np.uint8], starts: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Return times with a point, s, exactly in ns; None if one is not of that kind."""
    widths = ends - starts
    if not 0 < widths.min() <= widths.max() <= _MOST_WIDTH:
        return None
    number = np.zeros(len(starts), np.int64)
    places = np.full(len(starts), -1)  # digits behind the point; -1 before it
    for k in range(int(widths.max())):
        inside = k < widths
        letter = buffer[np.minimum(starts + k, len(buffer) - 1)]
        point, digit = inside & (letter == ord(".")), inside & (letter >= ord("0")) & (letter <= ord("9"))
        if (inside & ~point & ~digit).any() or (point & (places >= 0)).any() or (digit & (places >= _DIGITS)).any():
            return None
        number = np.where(digit, number * 10 + letter - ord("0"), number)
        places += digit & (places >= 0)
        places[point] = 0
    if (places < 0).any() or (number < 0).any() or (number // 10 ** places.clip(0) > _LATEST).any():
        return None
    return np.asarray(number * 10 ** (_DIGITS - places), np.int64)
