"""Write ROS camera_info: a calibration file (``image_width``, ``camera_matrix: {data}``, ...)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.camera.model import Camera
from dvrk_cmaes.camera.rig import View
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.json_file import write_text
from dvrk_cmaes.io.yaml_file import yaml_text


def write_camera_info(path: str | Path, camera: Camera, name: str, *, baseline: float = 0.0) -> None:
    """Write a ROS camera_info YAML file for images that are not rectified; arguments as of `camera_info_text`."""
    write_text(path, camera_info_text(camera, name, baseline=baseline))


def view_info_text(view: View, name: str) -> str:
    """Return ROS camera_info in YAML of a view of a rig, for images that are not rectified."""
    place = view.view_from_camera
    if np.array_equal(place, np.eye(4)):
        return camera_info_text(view.camera, name)
    return camera_info_text(view.camera, name, baseline=float(np.linalg.norm(place[:3, 3])), right_from_left=place)


def camera_info_text(
    camera: Camera, name: str, *, baseline: float = 0.0, right_from_left: Float64 | None = None
) -> str:
    """Return ROS camera_info in YAML for images that are not rectified.

    Of a right eye, ``baseline``, m, is that of the projection matrix, and ``right_from_left`` (4, 4), m, its pose,
    which counts where it is given.
    """
    K, D = camera.matrix, np.array([camera.distortion or (0.0,) * 5])
    P = np.c_[K, [-camera.fx * baseline, 0.0, 0.0]]
    document = camera_info((camera.width, camera.height), name, camera.model, K, D, np.eye(3), P)
    if right_from_left is not None:
        document["right_from_left"] = right_from_left.tolist()
    return yaml_text(document)


def camera_info(
    size: tuple[int, int], name: str, model: str, K: Float64, D: Float64, R: Float64, P: Float64
) -> dict[str, Any]:
    """Return the document of a camera_info file of a size, width and height; K, R (3, 3), D (1, N), P (3, 4)."""
    return {
        "image_width": size[0],
        "image_height": size[1],
        "camera_name": name,
        "camera_matrix": _matrix(K),
        "distortion_model": model,
        "distortion_coefficients": _matrix(D),
        "rectification_matrix": _matrix(R),
        "projection_matrix": _matrix(P),
    }


def _matrix(values: Float64) -> dict[str, Any]:
    """Return a matrix as camera_info states it."""
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}
