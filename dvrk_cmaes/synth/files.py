"""Plain numbers of synthetic frames: those of the truth for JSON, and the readings as joints.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.json_file import write_json, write_text
from dvrk_cmaes.synth.truth import Truth


def rounded(array: NDArray[np.floating], digits: int = 9) -> Any:
    """Convert an array to nested lists of rounded numbers, with 0.0 for -0.0."""
    return (np.round(np.asarray(array, dtype=np.float64), digits) + 0.0).tolist()


def rounded_joints(joints: Mapping[str, float], digits: int = 6) -> dict[str, float]:
    """Round joint values by name, with 0.0 for -0.0."""
    return {name: round(float(value), digits) + 0.0 for name, value in joints.items()}


def rounded_truth(truth: Truth, name_of_pose: str = "T_camera_roll_link") -> dict[str, Any]:
    """Convert pose, joints and tips in the camera's frame to plain numbers, with the given key for the pose."""
    return {
        name_of_pose: rounded(truth.camera_from_root),
        "joints": rounded_joints({**truth.joints, **truth.outer}, digits=9),
        "tips_camera_m": rounded(truth.tips),
    }


def write_golden(path: str | Path, base: NDArray[np.floating] | None, truths: Mapping[str, Truth]) -> None:
    """Write a golden.json of ``camera_from_base`` (4, 4), m, None if it is not known, and of frames by name."""
    frames = {name: rounded_truth(truth) for name, truth in truths.items()}
    write_json(path, {"camera_from_base": None if base is None else rounded(base), "frames": frames})


def write_joints(path: str | Path, readings: Mapping[str, Mapping[str, float]], columns: Sequence[str]) -> None:
    """Write a joints.csv with the columns frame and ``columns``, from readings by frame and joint, rad and m."""
    rows = ([frame, *(f"{reading[name]:.6f}" for name in columns)] for frame, reading in readings.items())
    write_text(path, csv_text(["frame", *columns], rows))
