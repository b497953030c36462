"""Markers painted on an instrument: their positions on its links (JSON), and their detections in images (CSV).

The table of positions is ``{"markers": {name: {"link": text, "position_m": [x, y, z]}}}``, or the inner object alone.
The detections of a session, markers.csv, have the columns ``frame, marker, u, v`` in pixels, one row per detection.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from msgspec import Meta, Struct

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.csv_file import number_in, read_csv_rows
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.io.typed_document import Point, convert_document, refused

_COLUMNS: Final = ("frame", "marker", "u", "v")


class Marker(Struct, frozen=True, eq=False, rename={"position": "position_m"}):
    """A point on an instrument: the name of a link of the URDF, and the position (3,) in that link's frame, m."""

    link: Annotated[str, Meta(min_length=1, description="the name of a link")]
    position: Annotated[Point, Meta(description="3 finite numbers in metres")]


def read_marker_table(path: str | Path) -> dict[str, Marker]:
    """Read the positions of markers on an instrument, by name.

    Raises
    ------
    InputError
        Naming the file, the marker and the field, and what was expected.
    """
    document = read_json_object(path, expected="positions of markers (JSON)")
    entries = document.get("markers", document)
    if not isinstance(entries, dict) or not entries:
        raise InputError(f"{path}: markers: expected an object of link and position_m by name, got {shown(entries)}")
    return {name: _read_marker(f"{path}: {shown(name)}", entry) for name, entry in entries.items()}


def _read_marker(where: str, document: Any) -> Marker:
    marker = convert_document(where, document, Marker)
    if np.abs(marker.position).max() > 1:
        raise refused(where, "position_m", "metres; this looks like millimetres", document["position_m"])
    return marker


def read_detections(path: str | Path) -> dict[str, dict[str, Float64]]:
    """Read a markers.csv: the pixel (2,) of each detected marker, by frame and name.

    Raises
    ------
    InputError
        Naming the file and the line, and what was expected; also for a marker that occurs twice in a frame.
    """
    header, rows = read_csv_rows(path, expected="detections of markers (markers.csv)")
    if header != list(_COLUMNS):
        raise InputError(f"{path}: header: expected {','.join(_COLUMNS)}, got {listed(header)}")
    detections: dict[str, dict[str, Float64]] = {}
    for where, cells in rows:
        frame, marker = cells["frame"], cells["marker"]
        if not frame or not marker:
            raise InputError(f"{where}: expected a frame, a marker, u and v, got {listed(cells.values())}")
        seen = detections.setdefault(frame, {})
        if marker in seen:
            raise InputError(f"{where}: expected each marker once a frame, got {shown(marker)} again")
        seen[marker] = np.array([number_in(where, name, cells, "pixels") for name in "uv"])
    return detections


def place_markers(instrument: Instrument, joints: Float64, table: Mapping[str, Marker]) -> dict[str, Float64]:
    """Compute the positions (3,) of markers in the root link's frame, m, for joint values (J,).

    Raises
    ------
    InputError
        The link of a marker is not in the instrument.
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
