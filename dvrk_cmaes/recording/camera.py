"""Camera files of imported sessions, from a given file or from a CameraInfo message."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dvrk_cmaes.camera.document import read_fields
from dvrk_cmaes.camera.files import read_camera_file
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.yaml_file import yaml_text

_LARGEST = 1_000_000  # bytes


def read_camera_bytes(path: Path) -> bytes:
    """Read the bytes of a camera file, unchanged; InputError if it is not a camera file."""
    read_camera_file(path)
    return read_bytes(path, expected="a camera file", largest=_LARGEST)


def with_pose(right: Mapping[str, Any], right_from_left: Float64) -> bytes:
    """Return the camera file of a right eye, given its content, with the pose (4, 4), m, of raw cameras added."""
    return yaml_text({**right, "right_from_left": right_from_left.tolist()}).encode()


def camera_file(message: Any, name: str, where: str) -> bytes:
    """Convert a sensor_msgs/CameraInfo message to a YAML file in the format of ROS' camera_calibration.

    Parameters
    ----------
    message
        The message, of ROS 1 (fields K, D, R, P) or ROS 2 (fields k, d, r, p).
    name
        The camera's name.
    where
        The recording and the topic, for messages.

    Raises
    ------
    InputError
        The message is not that of a camera; names the topic and the field of the message.
    """

    def numbers(letter: str) -> list[float]:
        """Return a field's numbers by its upper-case name."""
        values = getattr(message, letter, None)
        return [float(v) for v in (getattr(message, letter.lower()) if values is None else values)]

    region = {key: int(getattr(message.roi, key)) for key in ("x_offset", "y_offset", "height", "width")}
    fields: dict[str, Any] = {letter: numbers(letter) for letter in "KDRP"}
    size = {"width": int(message.width), "height": int(message.height)}
    model = str(message.distortion_model)
    read_fields(where, {**size, **fields, "distortion_model": model, "roi": region}, rectified=False, side="left")
    matrices = (
        ("distortion_coefficients", "D", 1, len(fields["D"])),
        ("camera_matrix", "K", 3, 3),
        ("rectification_matrix", "R", 3, 3),
        ("projection_matrix", "P", 3, 4),
    )
    document: dict[str, Any] = {
        "image_width": size["width"],
        "image_height": size["height"],
        "camera_name": name,
        "distortion_model": model,
        **{name: {"rows": rows, "cols": cols, "data": fields[letter]} for name, letter, rows, cols in matrices},
    }
    if any(region.values()):
        document["roi"] = region
    return yaml_text(document).encode()
