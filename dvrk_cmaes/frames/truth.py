"""Read and write ``golden.json``: ground truth of a session's frames, or poses to compare later results with.

``frames``, by name: ``T_camera_roll_link`` 4 x 4 (camera_from_root), ``joints`` by name, ``tips_camera_m`` if known,
and ``visible``, the share of the jaws that the image shows, 1 if not stated.
``camera_from_base``: 4 x 4 or null.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.rounding import rounded_array, rounded_values
from dvrk_cmaes.io.typed_document import Number, Point, Transform, convert_document, present_fields, refused

_EXPECTED = "the truth of a session (golden.json)"
_MOST_TIPS = 2


class _TruthEntry(Struct):
    T_camera_roll_link: Transform
    joints: dict[str, Number]
    tips_camera_m: tuple[Point, ...] | None = None
    visible: Annotated[float, Meta(ge=0, le=1, description="a number from 0 to 1")] = 1.0


class _TruthDocument(Struct):
    frames: dict[str, Any]
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
    frames = {name: _read_frame(f"{path}: frame {name}", entry) for name, entry in document.frames.items()}
    return SessionTruth(frames, document.camera_from_base)


def write_golden(path: str | Path, truth: SessionTruth) -> None:
    """Write a golden.json atomically; errors as in `dvrk_cmaes.io.output.write_bytes`."""
    base = truth.camera_from_base
    write_json(
        path,
        {
            "frames": {name: _entry(frame) for name, frame in truth.frames.items()},
            "camera_from_base": None if base is None else rounded_array(base),
        },
    )


def _read_frame(where: str, document: object) -> FrameTruth:
    fields = present_fields(where, document)
    if not fields.get("tips_camera_m"):
        fields.pop("tips_camera_m", None)  # an empty list for an instrument without jaws
    entry = convert_document(where, fields, _TruthEntry)
    tips = None if entry.tips_camera_m is None else np.stack(entry.tips_camera_m)
    if tips is not None and len(tips) > _MOST_TIPS:
        raise refused(where, "tips_camera_m", "1 or 2 rows of 3 finite numbers", tips.tolist())
    return FrameTruth(entry.T_camera_roll_link, entry.joints, tips, entry.visible)


def _entry(frame: FrameTruth) -> dict[str, Any]:
    entry = {"T_camera_roll_link": rounded_array(frame.camera_from_root), "joints": rounded_values(frame.joints)}
    if frame.tips is not None:
        entry["tips_camera_m"] = rounded_array(frame.tips)
    return entry if frame.visible == 1 else {**entry, "visible": frame.visible}
