"""Writing of synthetic frames: files of a session folder, and plain numbers for JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.io.atomic import write_text
from dvrk_cmaes.synth.truth import Truth


def rounded(array: NDArray[np.floating], digits: int = 9) -> Any:
    """Convert an array to nested lists of rounded numbers, with 0.0 for -0.0."""
    return (np.round(np.asarray(array, dtype=np.float64), digits) + 0.0).tolist()


def rounded_joints(joints: Mapping[str, float], digits: int = 6) -> dict[str, float]:
    """Round joint values by name, with 0.0 for -0.0."""
    return {name: round(float(value), digits) + 0.0 for name, value in joints.items()}


def rounded_truth(truth: Truth, name_of_pose: str, name_of_tips: str) -> dict[str, Any]:
    """Convert pose, joints and tips in the camera's frame to plain numbers, with the given keys for pose and tips."""
    return {
        name_of_pose: rounded(truth.camera_from_root),
        "joints": rounded_joints({**truth.joints, **truth.outer}, digits=9),
        name_of_tips: rounded(truth.tips),
    }


def write_camera_info(path: str | Path, camera: Camera, name: str, *, baseline: float = 0.0) -> None:
    """Write a ROS camera_info YAML file for images that are not rectified; ``baseline``, m, is that of a right eye."""
    K = camera.matrix
    document = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": _matrix(K),
        "distortion_model": camera.model,
        "distortion_coefficients": _matrix(np.array([camera.distortion or (0.0,) * 5])),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(np.c_[K, [-camera.fx * baseline, 0.0, 0.0]]),
    }
    write_text(path, yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=120))


def _matrix(values: NDArray[np.float64]) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}


def write_joints(path: str | Path, readings: Mapping[str, Mapping[str, float]], columns: Sequence[str]) -> None:
    """Write a joints.csv with the columns frame and ``columns``, from readings by frame and joint, rad and m."""
    lines = [",".join(["frame", *columns])]
    lines += [",".join([frame, *(f"{reading[name]:.6f}" for name in columns)]) for frame, reading in readings.items()]
    write_text(path, "\n".join(lines) + "\n")
