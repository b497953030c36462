"""Markers painted on an instrument: where they lie on its links (a JSON table), and where a detector saw them (CSV).

The table: ``{"markers": {name: {"link": text, "position_m": [x, y, z]}}}``, or that inner object by itself. The
detections, a session's markers.csv: columns ``frame, marker, u, v``, pixels; a frame has as many rows as were seen.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.shown import listed, shown

_COLUMNS: Final = ("frame", "marker", "u", "v")
_LARGEST: Final = 100_000_000  # bytes


@dataclass(frozen=True, eq=False)
class Marker:
    """A point on an instrument: the URDF's link, and its position (3,) in that link's frame, m."""

    link: str
    position: NDArray[np.float64]


Detections = Mapping[str, Mapping[str, NDArray[np.float64]]]
"""Pixels (2,) by frame and marker."""


def read_marker_table(path: str | Path) -> dict[str, Marker]:
    """Read where markers lie on an instrument, by name.

    Raises
    ------
    InputError
        Naming the file, the marker and the field, and what was expected.
    """
    document = read_json_object(path, expected="positions of markers (JSON)")
    entries = document.get("markers", document)
    if not isinstance(entries, dict) or not entries:
        raise InputError(f"{path}: markers: expected an object of link and position_m by name, got {shown(entries)}")
    return {name: _marker(f"{path}: {shown(name)}", entry) for name, entry in entries.items()}


def _marker(where: str, entry: Any) -> Marker:
    link = entry.get("link") if isinstance(entry, dict) else None
    if not isinstance(link, str) or not link:
        raise InputError(f"{where}: link: expected the name of a link, got {shown(link)}")
    position = entry.get("position_m")
    numbers = position if isinstance(position, list) else []
    if len(numbers) != 3 or not all(_finite(value) for value in numbers):
        raise InputError(f"{where}: position_m: expected three finite numbers in metres, got {shown(position)}")
    if max(abs(value) for value in numbers) > 1:
        raise InputError(f"{where}: position_m: expected metres, got {shown(position)}: this looks like millimetres")
    return Marker(link, np.array(numbers, dtype=np.float64))


def _finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def read_detections(path: str | Path) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Read a markers.csv: pixel (2,) of each marker seen, by frame and name.

    Raises
    ------
    InputError
        Naming the file and the line, and what was expected; a marker seen twice in a frame.
    """
    text = read_text(path, expected="detections of markers (markers.csv)", largest=_LARGEST)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    found: dict[str, dict[str, NDArray[np.float64]]] = {}
    try:
        header = [name.strip() for name in next(reader, [])]
        if header != list(_COLUMNS):
            raise InputError(f"{path}: header: expected {','.join(_COLUMNS)}, got {listed(header)}")
        for row in reader:
            cells = [cell.strip() for cell in row]
            if not any(cells):
                continue
            where = f"{path}: line {reader.line_num}"
            if len(cells) != len(_COLUMNS) or not cells[0] or not cells[1]:
                raise InputError(f"{where}: expected a frame, a marker, u and v, got {listed(cells)}")
            seen = found.setdefault(cells[0], {})
            if cells[1] in seen:
                raise InputError(f"{where}: expected each marker once a frame, got {shown(cells[1])} again")
            seen[cells[1]] = np.array([_pixel(where, name, cell) for name, cell in zip("uv", cells[2:], strict=True)])
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: expected valid CSV, got {error}") from None
    return found


def _pixel(where: str, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {name}: expected a finite number of pixels, got {shown(cell)}")
    return value
