"""Markers painted on an instrument: where they lie on its links (a JSON table), and where a detector saw them (CSV).

The table: ``{"markers": {name: {"link": text, "position_m": [x, y, z]}}}``, or that inner object by itself. The
detections, a session's markers.csv: columns ``frame, marker, u, v``, pixels; a frame has as many rows as were seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.document import Fields
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.csv_file import number_in, read_csv_rows
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.shown import listed, shown

_COLUMNS: Final = ("frame", "marker", "u", "v")


@dataclass(frozen=True, eq=False)
class Marker:
    """A point on an instrument: the URDF's link, and its position (3,) in that link's frame, m."""

    link: str
    position: NDArray[np.float64]


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
    return {name: _marker(Fields.of(f"{path}: {shown(name)}", entry)) for name, entry in entries.items()}


def _marker(fields: Fields) -> Marker:
    link, position = fields.text("link"), fields.array("position_m", (3,))
    if not link:
        raise fields.refuse("link", "the name of a link")
    if position is None:
        raise fields.refuse("position_m", "3 finite numbers in metres")
    if np.abs(position).max() > 1:
        raise fields.refuse("position_m", "metres; this looks like millimetres")
    return Marker(link, position)


def read_detections(path: str | Path) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Read a markers.csv: pixel (2,) of each marker seen, by frame and name.

    Raises
    ------
    InputError
        Naming the file and the line, and what was expected; a marker seen twice in a frame.
    """
    header, rows = read_csv_rows(path, expected="detections of markers (markers.csv)")
    if header != list(_COLUMNS):
        raise InputError(f"{path}: header: expected {','.join(_COLUMNS)}, got {listed(header)}")
    found: dict[str, dict[str, NDArray[np.float64]]] = {}
    for where, cells in rows:
        frame, marker = cells["frame"], cells["marker"]
        if not frame or not marker:
            raise InputError(f"{where}: expected a frame, a marker, u and v, got {listed(cells.values())}")
        seen = found.setdefault(frame, {})
        if marker in seen:
            raise InputError(f"{where}: expected each marker once a frame, got {shown(marker)} again")
        seen[marker] = np.array([number_in(where, name, cells, "pixels") for name in "uv"])
    return found
