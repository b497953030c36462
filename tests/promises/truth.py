"""What commands wrote, and how far it is from the truth of a drawn session."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np


def results(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the results of a folder by frame."""
    return {path.stem: json.loads(path.read_text()) for path in sorted((folder / "frames").iterdir())}


def tracks(folder: Path) -> dict[str, dict[str, Any]]:
    """Read a followed recording by frame."""
    rows = [json.loads(line) for line in (folder / "tracks.jsonl").read_text().splitlines()]
    return {row["frame"]: row for row in rows}


def _golden(session: Path, arm: str) -> Any:
    return json.loads((session / (f"golden_{arm}.json" if arm else "golden.json")).read_text())


def truth(session: Path, arm: str = "") -> dict[str, dict[str, Any]]:
    """Read the true poses of a session by frame."""
    frames: dict[str, dict[str, Any]] = _golden(session, arm)["frames"]
    return frames


def true_base(session: Path, arm: str = "") -> np.ndarray:
    """Read the true base (4, 4) of an arm in the camera."""
    return matrix(_golden(session, arm), "camera_from_base")


def calibration_in(folder: Path) -> Any:
    """Read the document of a calibration."""
    return json.loads((folder / "session.json").read_text())


def matrix(document: Mapping[str, Any], name: str) -> np.ndarray:
    """Give a 4 x 4 transform of a document."""
    found = np.array(document[name], float)
    assert found.shape == (4, 4)
    return found


def tip_errors(found: Mapping[str, Any], true: Mapping[str, Any]) -> np.ndarray:
    """Give the distances (2,) of the jaw tips from their true positions, mm."""
    return np.linalg.norm(np.subtract(found["tips"], true["tips_camera_m"]), axis=1) * 1e3


def distance(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Give how far a transform is from the true one, in mm and degrees."""
    turn = np.linalg.inv(true[:3, :3]) @ found[:3, :3]
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0)))
    return float(np.linalg.norm(found[:3, 3] - true[:3, 3]) * 1e3), float(angle)


def median(values: Sequence[float] | np.ndarray) -> float:
    """Give the median."""
    return float(np.median(values))
