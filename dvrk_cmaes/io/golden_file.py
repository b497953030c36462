"""Known truth of a session's frames: ``golden.json``, to compare results with."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.shown import shown

_EXPECTED = "the truth of a session (golden.json)"
_LARGEST = 100_000_000  # bytes


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """True ``camera_from_root`` (4, 4) and joints, rad or m, of one frame."""

    camera_from_root: NDArray[np.float64]
    joints: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class SessionTruth:
    """Truth of each frame by name, and ``camera_from_base`` (4, 4) where it is known."""

    frames: Mapping[str, FrameTruth] = field(default_factory=dict)
    camera_from_base: NDArray[np.float64] | None = None


def read_golden(path: str | Path) -> SessionTruth:
    """Read a golden.json: ``{"frames": {name: {"T_camera_roll_link", "joints"}}, "camera_from_base"}``.

    Raises
    ------
    InputError
        Naming the file, the frame and the field, and what was expected.
    """
    try:
        document = json.loads(read_text(path, expected=_EXPECTED, largest=_LARGEST))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected {_EXPECTED}, got no valid JSON ({error})") from None
    frames = _mapping(str(path), "frames", document)
    base = document.get("camera_from_base")
    return SessionTruth(
        frames={name: _frame(f"{path}: frame {name}", entry) for name, entry in frames.items()},
        camera_from_base=None if base is None else _pose(f"{path}: camera_from_base", base),
    )


def _frame(where: str, entry: Any) -> FrameTruth:
    joints = _mapping(where, "joints", entry)
    for name, value in joints.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise InputError(f"{where}: joints.{name}: expected a finite number, got {shown(value)}")
    pose = _pose(f"{where}: T_camera_roll_link", entry.get("T_camera_roll_link"))
    return FrameTruth(pose, {name: float(value) for name, value in joints.items()})


def _mapping(where: str, field_name: str, entry: Any) -> dict[str, Any]:
    """Entry of a mapping that must be a mapping itself."""
    value = entry.get(field_name) if isinstance(entry, dict) else None
    if not isinstance(value, dict):
        raise InputError(f"{where}: {field_name}: expected an object, got {shown(value)}")
    return value


def _pose(where: str, value: Any) -> NDArray[np.float64]:
    """Check a rigid transform (4, 4), rows first."""
    try:
        pose = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        pose = np.empty(0)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise InputError(f"{where}: expected 4 rows of 4 finite numbers, got {shown(value)}")
    off = np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max()
    if off > 1e-4 or np.linalg.det(pose[:3, :3]) < 0 or (pose[3] != [0, 0, 0, 1]).any():
        raise InputError(f"{where}: expected a rotation and a translation over 0 0 0 1, got {shown(value)}")
    return pose
