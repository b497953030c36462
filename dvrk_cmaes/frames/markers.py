"""Markers painted on an instrument: where they lie on its links (a JSON table), and where a detector saw them (CSV).

The table: ``{"markers": {name: {"link": text, "position_m": [x, y, z]}}}``, or that inner object by itself. The
detections, a session's markers.csv: columns ``frame, marker, u, v``, pixels; a frame has as many rows as were seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.csv_file import number_in, read_csv_rows
from dvrk_cmaes.io.fields import Fields
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import listed, shown

Float64 = NDArray[np.float64]

_COLUMNS: Final = ("frame", "marker", "u", "v")


@dataclass(frozen=True, eq=False)
class Marker:
    """A point on an instrument: the URDF's link, and its position (3,) in that link's frame, m."""

    link: str
    position: Float64


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


def read_detections(path: str | Path) -> dict[str, dict[str, Float64]]:
    """Read a markers.csv: pixel (2,) of each marker seen, by frame and name.

    Raises
    ------
    InputError
        Naming the file and the line, and what was expected; a marker seen twice in a frame.
    """
    header, rows = read_csv_rows(path, expected="detections of markers (markers.csv)")
    if header != list(_COLUMNS):
        raise InputError(f"{path}: header: expected {','.join(_COLUMNS)}, got {listed(header)}")
    found: dict[str, dict[str, Float64]] = {}
    for where, cells in rows:
        frame, marker = cells["frame"], cells["marker"]
        if not frame or not marker:
            raise InputError(f"{where}: expected a frame, a marker, u and v, got {listed(cells.values())}")
        seen = found.setdefault(frame, {})
        if marker in seen:
            raise InputError(f"{where}: expected each marker once a frame, got {shown(marker)} again")
        seen[marker] = np.array([number_in(where, name, cells, "pixels") for name in "uv"])
    return found


def place_markers(instrument: Instrument, joints: Float64, table: Mapping[str, Marker]) -> dict[str, Float64]:
    """Positions (3,) of markers in the root link's frame, m, with the joints (J,) as given.

    Raises
    ------
    InputError
        A marker on a link that the instrument has not.
    """
    children = {joint.child: index for index, joint in enumerate(instrument.chain.joints)}
    links = {instrument.root_link: -1, **children}
    for name, marker in table.items():
        if marker.link not in links:
            near = ", ".join(nearest_first(marker.link, links))
            raise InputError(f"marker {name}: link: expected one of {near} ({instrument.name}), got {marker.link!r}")
    wanted = sorted({marker.link for marker in table.values()})
    poses = dict(zip(wanted, instrument.chain.forward(joints, [links[link] for link in wanted]), strict=True))
    return {
        name: np.asarray(poses[marker.link][:3, :3] @ marker.position + poses[marker.link][:3, 3])
        for name, marker in table.items()
    }
