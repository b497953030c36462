"""Recordings of an endoscope that was steered: the camera in its tip and the arm's base against the truth, and cuts."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.endoscope import in_tip
from dvrk_cmaes.geometry import change_between, inverse, log_rotation
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.joints.names import ECM_JOINTS

_NEAR = 3.0  # frames
_STILL_DEG, _STILL_MM = 0.02, 0.02  # motion of the camera from frame to frame, below which it stands


def endoscope_figures(calibration: SessionCalibration | None, golden: Mapping[str, Any]) -> dict[str, Any]:
    """Return figures of a steered recording: errors in standard deviations, and frames from the cuts to the moves."""
    row: dict[str, Any] = {"tip, std": None, "arm's base, std": None, "cuts": None, "moves cut within 3 frames": None}
    found, truth = None if calibration is None else calibration.endoscope, golden["endoscope"]
    if found is None:
        return row
    if found.tip_from_camera is not None and found.ecm_from_base is not None:
        off = in_tip(found.tip_from_camera) @ change_between(found.tip_from_camera, np.array(truth["tip_from_camera"]))
        row["tip, std"] = float(np.abs(off / found.std_tip_from_camera).max())
        off = change_between(found.ecm_from_base, np.array(truth["ecm_from_base"]))
        row["arm's base, std"] = float(np.abs(off / found.std_ecm_from_base).max())
    else:
        names = list(golden["frames"])
        moves = true_moves(golden)
        cuts = [names.index(one.last) + 0.5 for one in found.bases[:-1]]
        row["cuts"] = len(cuts)
        away = [min((max(first - cut, cut - last, 0.0) for cut in cuts), default=np.inf) for first, last in moves]
        row["moves cut within 3 frames"] = f"{sum(one <= _NEAR for one in away)} of {len(moves)}"
    return row


def true_moves(golden: Mapping[str, Any]) -> list[tuple[int, int]]:
    """Return the first and the last frame of each move of the camera, by number."""
    bases = np.array([own["camera_from_base"] for own in golden["frames"].values()])
    relative = inverse(bases[:-1]) @ bases[1:]
    turned = np.degrees(np.linalg.norm(log_rotation(relative[:, :3, :3]), axis=1))
    moving = (turned > _STILL_DEG) | (1e3 * np.linalg.norm(relative[:, :3, 3], axis=1) > _STILL_MM)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moving, [False]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def without_ecm(folder: Path, out: Path) -> Path:
    """Copy a recording to a folder in ``out``, without the readings of the endoscope's arm; returns the copy."""
    copy = out / folder.name
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("run.json"))
    for path in copy.glob("joints*.csv"):
        header, *rows = (line.split(",") for line in path.read_text(encoding="utf-8").splitlines())
        kept = [k for k, name in enumerate(header) if name not in ECM_JOINTS]
        path.write_text(csv_text([header[k] for k in kept], ([row[k] for k in kept] for row in rows)), encoding="utf-8")
    return copy
