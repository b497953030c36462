"""The result of following an instrument to one image, its line in tracks.jsonl, and what the image shows of it.

Files of a followed recording: tracks.jsonl, a line for each frame, and tracks.csv, the same in columns.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from msgspec import Struct

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool, Float64, Image, log_rotation
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.encode import encoded, encoded_fields, rounded
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.json_file import parse_json, write_text
from dvrk_cmaes.io.typed_document import Count, Number, Point, Texts, Transform, convert_document, refused
from dvrk_cmaes.results.parts import PoseShown, data_frame, std_document

TrackStatus = Literal["ok", "doubtful", "lost"]


@dataclass(frozen=True)
class BaseKnown:
    """How far the arm's base is known from keyframes.

    keyframes : number of those that are kept. solved : keyframes of the last solution, 0 before the first. tip_mm :
    error of the tips, mm, that the last solution leaves; None if it has none. used : whether poses are those of a
    calibration.
    """

    keyframes: Count
    solved: Count
    tip_mm: Number | None
    used: bool


@dataclass(frozen=True, eq=False)
class TrackResult(PoseShown):
    """Pose and joints of a followed instrument at the time of one image.

    time : s. status : ``lost`` if no evidence supports the pose, which is then predicted. reasons : of another status
    than ``ok``. camera_from_root : (4, 4) m; None if lost without a prediction. joints : rad. covariance : (6 + J,
    6 + J) of [tx ty tz rx ry rz] in the root link's axes (m, rad), then of the joints (rad). tips : (K, 3) m, jaw tips
    in the camera. tip_std_mm : standard deviation of the tips, the norm over three axes, mean over the tips; None
    without tips. camera_from_base : (4, 4) m, None without readings of the outer joints. offsets : of roll and the
    joints, if they were read, rad: true = reading + offset. seconds : of this step. searched : whether the step
    included a global search. residual_px : standard deviation, px, of the distances between the outline and the edges
    that support it; None where none do, and in images that were searched globally. tip_probability : that the tips are
    within ``trust.tip_mm`` of their true positions; None without a pose, and where it is lost. base : how far the base
    is known, of a tracker that keeps keyframes. remarks : on the camera's file and the session that the result rests
    on; they do not decide the status. renderer : of the instrument in the first camera, for `overlay`; it is not
    pickled.
    """

    time: float
    status: TrackStatus
    reasons: tuple[str, ...]
    camera_from_root: Float64 | None
    joints: dict[str, float]
    covariance: Float64 | None
    tips: Float64 | None
    tip_std_mm: float | None
    camera_from_base: Float64 | None = None
    offsets: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    searched: bool = False
    residual_px: float | None = None
    tip_probability: float | None = None
    base: BaseKnown | None = None
    remarks: tuple[str, ...] = ()
    renderer: Any = field(default=None, repr=False)

    def __repr__(self) -> str:
        """Show the time, the status, the pose and the joints, in the units of reports; all fields are in `to_dict`."""
        tips = "" if self.tip_std_mm is None else f"tips std {self.tip_std_mm:.2g} mm"
        return self._in_one_line(f"time={self.time:.6g}", tips)

    def to_row(self, frame: str = "") -> dict[str, Any]:
        """Return the row of tracks.csv: a number or a text by column, with the unit in the column's name.

        Parameters
        ----------
        frame
            Name of the frame.
        """
        columns, (cells,) = table_cells([self.to_dict(frame)], tuple(self.joints))
        return dict(zip(columns, cells, strict=True))

    def to_frame(self, frame: str = "") -> Any:
        """Return the row of `to_row` as a pandas DataFrame.

        Parameters
        ----------
        frame
            Name of the frame.

        Raises
        ------
        InputError
            pandas is not installed.
        """
        return data_frame([self.to_row(frame)])

    def to_dict(self, frame: str, *, timed: bool = True) -> dict[str, Any]:
        """Return the line of a frame in tracks.jsonl; without ``timed``, its ``time`` is null.

        Parameters
        ----------
        frame
            Name of the frame.
        timed
            Whether the line has the image's time.
        """
        std = None
        if self.covariance is not None:
            std = std_document(self.covariance, tuple(self.joints)) | {"tip_mm": encoded(self.tip_std_mm)}
        return {
            "frame": frame,
            "time": rounded(self.time) if timed else None,
            **encoded_fields(self, "status", "reasons", "remarks", "camera_from_root", "joints"),
            "std": std,
            **encoded_fields(self, "tip_probability", "offsets", "tips"),
            "seconds": round(self.seconds, 5),
            **encoded_fields(self, "searched", "residual_px"),
            **({} if self.base is None else {"base": encoded(self.base)}),
        }


@dataclass(frozen=True, eq=False)
class TrackView:
    """A view of a frame: image (H, W, 3) BGR, mask and silhouette of the pose (H, W), each or None, of ``size`` px.

    ``axes`` (4, 2) px are the origin of the root link and the ends of its axes, ``tips`` (T, 2) px the jaws' tips.
    """

    image: Image | None
    mask: Bool | None
    silhouette: Bool | None
    size: tuple[int, int]
    axes: Float64 | None = None
    tips: Float64 | None = None


def without_pose(time: float, reason: str, *, searched: bool = False) -> TrackResult:
    """Return the result of an image of a time, s, of whose pose nothing is known, for a reason."""
    return TrackResult(time, "lost", (reason,), None, {}, None, None, None, searched=searched)


def doubted(result: TrackResult, reasons: Sequence[str]) -> TrackResult:
    """Return a result with further reasons, if there are any, for which it is not ok."""
    status: TrackStatus = "doubtful" if reasons and result.status == "ok" else result.status
    return replace(result, status=status, reasons=(*result.reasons, *reasons)) if reasons else result


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
    base: BaseKnown | None = None


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
