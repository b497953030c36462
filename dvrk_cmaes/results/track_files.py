"""Files of a followed recording: tracks.jsonl, a line for each frame, and tracks.csv, the same in columns."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import log_rotation
from dvrk_cmaes.io.atomic import write_text
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.json_file import parse_json
from dvrk_cmaes.io.typed_document import Count, Number, Point, Texts, Transform, convert_document, refused
from dvrk_cmaes.results.tracked import TrackStatus

TRACKS = "tracks.jsonl"
TABLE = "tracks.csv"
VIDEO = "tracks.mp4"

_LARGEST = 2_000_000_000  # bytes


def line_of(row: dict[str, Any]) -> str:
    """Return the line of a frame in tracks.jsonl, with its line break."""
    return json.dumps(row, allow_nan=False, ensure_ascii=False) + "\n"


def read_tracks(path: Path) -> list[dict[str, Any]]:
    """Read tracks.jsonl; an incomplete last line, of a run that was killed, is left out.

    Raises
    ------
    InputError
        The file cannot be read, or a line is not an object with a frame.
    """
    lines = read_bytes(path, expected="followed frames (tracks.jsonl)", largest=_LARGEST).split(b"\n")
    rows = []
    for number, line in enumerate(lines[:-1], start=1):
        try:
            row = parse_json(line.decode())
        except (ValueError, RecursionError):
            row = None
        if not isinstance(row, dict) or "frame" not in row:
            raise InputError(f"{path}:{number}: expected a JSON object with frame, got something else")
        _check_row(f"{path}:{number}", row)
        rows.append(row)
    return rows


class _Std(Struct):
    translation_mm: Point
    rotation_deg: Point
    joints_deg: dict[str, Number]
    tip_mm: Number | None = None


class _Base(Struct):
    keyframes: Count
    solved: Count
    tip_mm: Number | None
    used: bool


class _Row(Struct):
    """Fields of a line that are used after it is read."""

    frame: str
    time: Number | None
    status: TrackStatus
    reasons: Texts
    camera_from_root: Transform | None
    joints: dict[str, Number]
    std: _Std | None
    tips: tuple[Point, ...] | None
    seconds: Number
    offsets: dict[str, Number] = {}
    searched: bool = False
    residual_px: Number | None = None
    tip_probability: Number | None = None
    base: _Base | None = None


def _check_row(where: str, document: dict[str, Any]) -> None:
    row = convert_document(where, document, _Row)
    known = {} if row.std is None else row.std.joints_deg
    if row.camera_from_root is not None and (row.std is None or row.tips is None or set(known) != set(row.joints)):
        raise refused(where, "std", "standard deviations of the pose and of all joints, and tips", document["std"])


def table_cells(rows: Sequence[dict[str, Any]], joints: Sequence[str]) -> tuple[list[str], list[list[object]]]:
    """Return columns and cells of a table of lines of tracks.jsonl: mm, degrees, seconds, an empty text for none."""
    stds = [f"std_{axis}_mm" for axis in "xyz"] + [f"std_r{axis}_deg" for axis in "xyz"]
    tips = sorted({len(row["tips"]) for row in rows if row["tips"] is not None}, reverse=True)[:1] or [0]
    header = ["frame", "time", "status", "x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]
    header += [f"{name}_deg" for name in joints] + stds + [f"std_{name}_deg" for name in joints]
    header += [f"tip_{k + 1}_{axis}_mm" for k in range(tips[0]) for axis in "xyz"] + [
        "tip_probability",
        "seconds",
        "reasons",
    ]
    return header, [_cells(row, joints, tips[0]) for row in rows]


def write_table(path: Path, rows: Sequence[dict[str, Any]], joints: Sequence[str]) -> None:
    """Write the lines of tracks.jsonl as a table."""
    write_text(path, csv_text(*table_cells(rows, joints)))


def _cells(row: dict[str, Any], joints: Sequence[str], tips: int) -> list[object]:
    """Return the cells of one frame."""
    cells: list[object] = [row["frame"], "" if row["time"] is None else row["time"], row["status"]]
    if row["camera_from_root"] is None:
        cells += [""] * (12 + 2 * len(joints) + 3 * tips)
    else:
        pose = np.array(row["camera_from_root"])
        cells += np.round(pose[:3, 3] * 1e3, 4).tolist() + np.round(np.degrees(log_rotation(pose[:3, :3])), 4).tolist()
        cells += [round(float(np.degrees(row["joints"][name])), 4) for name in joints]
        std = row["std"]
        cells += [round(value, 4) for value in (*std["translation_mm"], *std["rotation_deg"])]
        cells += [round(std["joints_deg"][name], 4) for name in joints]
        cells += np.round(np.array(row["tips"], dtype=np.float64).ravel() * 1e3, 4).tolist()
    probability = row.get("tip_probability")
    return [*cells, "" if probability is None else probability, row["seconds"], "; ".join(row["reasons"])]
