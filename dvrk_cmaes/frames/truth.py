"""Read and write ``golden.json``: ground truth of a session's frames, or poses to compare later results with.

``frames``, by name: ``T_camera_roll_link`` 4 x 4 (camera_from_root), ``joints`` by name, ``tips_camera_m`` if known,
and ``visible``, the share of the jaws that the image shows, 1 if not stated.
``camera_from_base``: 4 x 4 or null.

A published.csv has the poses that the paper's authors published, one row per frame: ``frame, rx, ry, rz`` (axis-
angle, rad), ``tx, ty, tz`` (m) of camera_from_root, and the joints ``wrist_pitch, wrist_yaw, jaw_2, jaw_1`` (rad).
Each jaw has an angle of its own: the opening is the sum of the two, and half of their difference is added to the
wrist's yaw.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from msgspec import Meta, Struct

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, exp_rotation, transform
from dvrk_cmaes.io.csv_file import number_in, read_csv_rows, rows_by_frame
from dvrk_cmaes.io.encode import rounded_array, rounded_values
from dvrk_cmaes.io.json_file import read_json_object, write_json
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.io.typed_document import Number, Point, Transform, convert_document, refused

_EXPECTED = "the truth of a session (golden.json)"
_MOST_TIPS = 2


class _TruthEntry(Struct):
    T_camera_roll_link: Transform
    joints: dict[str, Number]
    tips_camera_m: tuple[Point, ...] | None = None
    visible: Annotated[float, Meta(ge=0, le=1, description="a number from 0 to 1")] | None = None


class _TruthDocument(Struct):
    frames: dict[str, _TruthEntry]
    camera_from_base: Transform | None = None


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """True ``camera_from_root`` (4, 4), joints (rad or m) and, if known, tips (2 or 1, 3) in the camera, m.

    ``visible`` is the share of the jaws that the image shows.
    """

    camera_from_root: Float64
    joints: Mapping[str, float]
    tips: Float64 | None = None
    visible: float = 1.0


@dataclass(frozen=True, eq=False)
class SessionTruth:
    """Truth of the frames by name, and ``camera_from_base`` (4, 4) if it is known."""

    frames: Mapping[str, FrameTruth] = field(default_factory=dict)
    camera_from_base: Float64 | None = None


def read_golden(path: str | Path) -> SessionTruth:
    """Read a golden.json.

    Raises
    ------
    InputError
        Naming the file, the frame and the field, and what was expected.
    """
    document = convert_document(str(path), read_json_object(path, expected=_EXPECTED), _TruthDocument)
    frames = {name: _truth(f"{path}: frames.{name}", entry) for name, entry in document.frames.items()}
    return SessionTruth(frames, document.camera_from_base)


def write_golden(path: str | Path, truth: SessionTruth) -> None:
    """Write a golden.json atomically; errors as in `dvrk_cmaes.io.output.write_bytes`."""
    base = None if truth.camera_from_base is None else rounded_array(truth.camera_from_base)
    frames = {name: truth_entry(frame) for name, frame in truth.frames.items()}
    write_json(path, {"camera_from_base": base, "frames": frames})


def _truth(where: str, entry: _TruthEntry) -> FrameTruth:
    tips = entry.tips_camera_m or ()  # an empty list for an instrument without jaws
    if len(tips) > _MOST_TIPS:
        raise refused(where, "tips_camera_m", "1 or 2 rows of 3 finite numbers", np.stack(tips).tolist())
    visible = 1.0 if entry.visible is None else entry.visible
    return FrameTruth(entry.T_camera_roll_link, entry.joints, np.stack(tips) if tips else None, visible)


def truth_entry(frame: FrameTruth) -> dict[str, Any]:
    """Return what golden.json has of a frame."""
    entry = {"T_camera_roll_link": rounded_array(frame.camera_from_root), "joints": rounded_values(frame.joints)}
    if frame.tips is not None:
        entry["tips_camera_m"] = rounded_array(frame.tips)
    return entry if frame.visible == 1 else {**entry, "visible": frame.visible}


_PUBLISHED: Final = "published poses (published.csv)"
_ROTATION: Final = ("rx", "ry", "rz")
_TRANSLATION: Final = ("tx", "ty", "tz")
_JOINTS: Final = ("wrist_pitch", "wrist_yaw", "jaw_2", "jaw_1")
_COLUMNS: Final = ("frame", *_ROTATION, *_TRANSLATION, *_JOINTS)


def read_published_poses(path: str | Path) -> dict[str, tuple[Float64, dict[str, float]]]:
    """Read a published.csv, by frame, in the order of its rows.

    Each frame has its ``camera_from_root`` (4, 4), m, and its joints wrist_pitch, wrist_yaw, jaw by name, rad.

    Raises
    ------
    InputError
        Naming the file, the line and the column, and what was expected.
    """
    header, rows = read_csv_rows(path, expected=_PUBLISHED)
    missing = [name for name in _COLUMNS if name not in header]
    if missing:
        raise InputError(f"{path}: header: expected {','.join(_COLUMNS)}, got no {listed(missing)}")
    poses = {
        frame: _pose({name: number_in(where, name, cells) for name in _COLUMNS[1:]})
        for frame, (where, cells) in rows_by_frame(rows).items()
    }
    if not poses:
        raise InputError(f"{path}: expected a row for each frame, got a header only")
    return poses


def _pose(row: dict[str, float]) -> tuple[Float64, dict[str, float]]:
    rotation = exp_rotation([row[name] for name in _ROTATION])
    first, second = row["jaw_2"], row["jaw_1"]
    joints = {
        "wrist_pitch": row["wrist_pitch"],
        "wrist_yaw": row["wrist_yaw"] + (second - first) / 2,
        "jaw": first + second,
    }
    return transform(rotation, [row[name] for name in _TRANSLATION]), joints
