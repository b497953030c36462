"""Known truth of a session's frames, or poses kept to compare later ones with: ``golden.json``.

``frames``, by name: ``T_camera_roll_link`` 4 x 4 (camera_from_root), ``joints`` by name, ``tips_camera_m`` if known.
``camera_from_base``: 4 x 4 or null.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.io.fields import Fields
from dvrk_cmaes.io.json_file import read_json_object

_EXPECTED = "the truth of a session (golden.json)"


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """True ``camera_from_root`` (4, 4), joints, rad or m, and if known the jaw tips (2, 3) in the camera, m."""

    camera_from_root: NDArray[np.float64]
    joints: Mapping[str, float]
    tips: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class SessionTruth:
    """Truth of each frame by name, and ``camera_from_base`` (4, 4) where it is known."""

    frames: Mapping[str, FrameTruth] = field(default_factory=dict)
    camera_from_base: NDArray[np.float64] | None = None


def read_golden(path: str | Path) -> SessionTruth:
    """Read a golden.json.

    Raises
    ------
    InputError
        Naming the file, the frame and the field, and what was expected.
    """
    fields = Fields(str(path), read_json_object(path, expected=_EXPECTED))
    frames = fields.inner("frames", required=True)
    assert frames is not None
    return SessionTruth(
        frames={name: _frame(Fields.of(f"{path}: frame {name}", entry)) for name, entry in frames.values.items()},
        camera_from_base=fields.pose("camera_from_base"),
    )


def write_golden(path: str | Path, truth: SessionTruth) -> None:
    """Write a golden.json, whole or not at all; errors as `dvrk_cmaes.io.atomic.write_bytes`."""
    base = truth.camera_from_base
    write_json(
        path,
        {
            "frames": {name: _entry(frame) for name, frame in truth.frames.items()},
            "camera_from_base": None if base is None else _rounded(base),
        },
    )


def _frame(fields: Fields) -> FrameTruth:
    joints = fields.numbers("joints", required=True)
    pose = fields.pose("T_camera_roll_link", required=True)
    assert pose is not None
    tips = fields.array("tips_camera_m", (2, 3)) if fields.values.get("tips_camera_m") else None  # a hook has none
    return FrameTruth(pose, joints, tips)


def _entry(frame: FrameTruth) -> dict[str, Any]:
    entry = {
        "T_camera_roll_link": _rounded(frame.camera_from_root),
        "joints": {name: round(float(value), 9) for name, value in frame.joints.items()},
    }
    return entry if frame.tips is None else {**entry, "tips_camera_m": _rounded(frame.tips)}


def _rounded(array: NDArray[np.float64]) -> Any:
    """Numbers to a nanometre, as results have them."""
    return np.round(array, 9).tolist()
