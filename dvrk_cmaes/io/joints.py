"""Joint readings: one frame's, from a joints.csv or written out as ``name=value,name=value``.

Columns of joints.csv are ``frame`` (text: "0026" is not "26"), an optional ``time`` in seconds and any of the joints;
revolute ones in radians, ``insertion`` in metres. A column that is not there or a blank cell is a reading that is not
known, which is not the same as zero.
"""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterable
from pathlib import Path

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.shown import listed, shown

OUTER_JOINTS = ("yaw", "pitch", "insertion", "roll")
"""Joints of the arm that carries the instrument, from the base outwards."""

WRIST_JOINTS = ("wrist_pitch", "wrist_yaw", "jaw")
"""Joints of the instrument that the camera sees."""

_LARGEST = 100_000_000  # bytes; a million frames
_EXPECTED = "joint readings (joints.csv, or name=value,name=value)"


def read_joints(text_or_path: str | Path, *, frame: str | None = None, known: Iterable[str] = ()) -> dict[str, float]:
    """Read the joint readings of one frame.

    Parameters
    ----------
    text_or_path
        ``wrist_pitch=-0.68,wrist_yaw=-0.36,jaw=1.34``, or the path of a joints.csv. Text with an equals sign is a
        path only if such a file exists.
    frame
        Which row of a joints.csv; may be left out if it has one row only. Not used for written-out readings.
    known
        Names of the instrument's own joints, besides ``OUTER_JOINTS`` and ``WRIST_JOINTS``.

    Returns
    -------
    dict
        Joint name to reading, rad, or m for ``insertion``; only the joints that were read.

    Raises
    ------
    InputError
        Naming the file and the frame or the joint, and what was expected.
    """
    names = _names(known)
    if is_written_out(text_or_path):
        return _written_out(str(text_or_path), names)
    path = str(text_or_path)
    rows = _rows(path, names)
    return _row_readings(path, rows[_chosen(path, frame, list(rows))])


def read_joint_table(path: str | Path, *, known: Iterable[str] = ()) -> dict[str, dict[str, float]]:
    """Read the joint readings of all frames of a joints.csv, by frame in the order of its rows.

    ``known`` and the errors are those of ``read_joints``.
    """
    rows = _rows(str(path), _names(known))
    return {frame: _row_readings(str(path), row) for frame, row in rows.items()}


def is_written_out(text_or_path: str | Path) -> bool:
    """Whether readings are written out as ``name=value,...`` rather than named by a path."""
    return isinstance(text_or_path, str) and "=" in text_or_path and not os.path.exists(text_or_path)


def _names(known: Iterable[str]) -> tuple[str, ...]:
    """All joints that a reading may be of, each once."""
    return tuple(dict.fromkeys((*WRIST_JOINTS, *OUTER_JOINTS, *known)))


def _row_readings(path: str, row: dict[str, str]) -> dict[str, float]:
    """Values of the cells of a row that are not blank."""
    return {
        name: _reading(f"{path}: frame {row['frame']}", name, cell)
        for name, cell in row.items()
        if name not in ("frame", "time") and cell
    }


def _written_out(text: str, names: tuple[str, ...]) -> dict[str, float]:
    """Parse readings written as ``name=value,name=value``."""
    readings: dict[str, float] = {}
    for item in text.split(","):
        name, equals, value = (part.strip() for part in item.partition("="))
        if not equals:
            raise InputError(f"joints: expected name=value,name=value, got {shown(item.strip())}")
        _check_name("joints", name, names)
        if name in readings:
            raise InputError(f"joints: {name}: expected one reading, got two")
        readings[name] = _reading("joints", name, value)
    return readings


def _rows(path: str, names: tuple[str, ...]) -> dict[str, dict[str, str]]:
    """Rows of a joints.csv by frame, cells as text; the names of the columns are checked."""
    text = read_text(path, expected=_EXPECTED, largest=_LARGEST)
    reader = csv.reader(io.StringIO(text, newline=""))
    rows: dict[str, dict[str, str]] = {}
    try:
        header = [name.strip() for name in next(reader, [])]
        _check_header(path, header, names)
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            where = f"{path}: line {reader.line_num}"
            if len(cells) != len(header):
                raise InputError(f"{where}: expected {len(header)} cells as in the header, got {len(cells)}")
            row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
            if not row["frame"]:
                raise InputError(f"{where}: frame: expected a name, got a blank cell")
            if row["frame"] in rows:
                raise InputError(f"{where}: frame: expected each frame once, got {shown(row['frame'])} again")
            rows[row["frame"]] = row
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: expected {_EXPECTED}, got no valid CSV ({error})") from None
    if not rows:
        raise InputError(f"{path}: expected a row for each frame, got a header only")
    return rows


def _check_header(path: str, header: list[str], names: tuple[str, ...]) -> None:
    if "frame" not in header:
        raise InputError(f"{path}: header: expected a column frame and columns of joints, got {listed(header)}")
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{path}: header: expected each column once, got {shown(name)} twice")
        if name not in ("frame", "time"):
            _check_name(f"{path}: header", name, names)


def _check_name(where: str, name: str, names: tuple[str, ...]) -> None:
    if name not in names:
        near = ", ".join(nearest_first(name[:60], names))
        raise InputError(f"{where}: unknown joint {shown(name)}; expected one of {near}")


def _chosen(path: str, frame: str | None, frames: list[str]) -> str:
    """Which of the frames is meant."""
    if frame is None:
        if len(frames) == 1:
            return frames[0]
        raise InputError(
            f"{path}: frame: expected the name of one of its {len(frames)} frames ({listed(frames)}), got none"
        )
    if frame not in frames:
        near = listed(nearest_first(frame, frames))
        raise InputError(f"{path}: frame: expected one of its {len(frames)} frames ({near}), got {shown(frame)}")
    return frame


def _reading(where: str, name: str, cell: str) -> float:
    """Value of a cell; refuses what can only be another unit."""
    unit = "m" if name == "insertion" else "rad"
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {name}: expected a finite number in {unit}, got {shown(cell)}")
    if unit == "m" and abs(value) > 1:
        raise InputError(f"{where}: {name}: expected metres, got {value:g}: this looks like millimetres")
    if unit == "rad" and abs(value) > 2 * math.pi:
        raise InputError(f"{where}: {name}: expected radians (at most 2 pi), got {value:g}: this looks like degrees")
    return value
