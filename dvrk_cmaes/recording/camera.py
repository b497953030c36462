"""Camera files of imported sessions, from a given file, a CameraInfo message, or an INI file as SurgPose has it.

Of a StereoCalibrationDVRK.ini, ``[StereoLeft]`` and ``[StereoRight]`` state the size ``res_x``, ``res_y``, the
intrinsics ``fc_x``, ``fc_y``, ``cc_x``, ``cc_y``, px, and the distortion ``kc_0`` to ``kc_7`` in OpenCV's order.
``[StereoRight]`` has the pose between the cameras, too: ``R_0`` to ``R_8`` in rows and ``T_0`` to ``T_2``, m or mm,
from the left camera to the right one.
"""

from __future__ import annotations

from configparser import ConfigParser, SectionProxy
from configparser import Error as IniError
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.document import read_fields
from dvrk_cmaes.camera.fields import Side, as_number, take_length
from dvrk_cmaes.camera.files import read_camera_file
from dvrk_cmaes.camera.ros import camera_info, camera_info_text
from dvrk_cmaes.camera.stereo import pose_of_storage
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_bytes, read_text
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.io.yaml_file import yaml_text

NO_CAMERA: Final = Path("none")
"""What is given as a camera file where there is none."""

WITHOUT: Final = "without a calibration: --camera none, then `dvrk-cmaes calibrate` (`dvrk-cmaes help uncalibrated`)"
"""What to do where there is no camera file."""

_LARGEST = 1_000_000  # bytes


def read_camera_bytes(path: Path) -> bytes:
    """Read the bytes of a camera file, unchanged, none of `NO_CAMERA`; InputError if it is not a camera file."""
    if path == NO_CAMERA:
        return b""
    read_camera_file(path)
    return read_bytes(path, expected="a camera file", largest=_LARGEST)


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
    fields = {letter: numbers(letter) for letter in "KDRP"}
    width, height, model = int(message.width), int(message.height), str(message.distortion_model)
    stated = {"width": width, "height": height, "distortion_model": model, "roi": region}
    read_fields(where, {**stated, **fields}, rectified=False, side="left")
    shapes = {"K": (3, 3), "D": (1, -1), "R": (3, 3), "P": (3, 4)}
    matrices = (np.array(fields[letter]).reshape(shape) for letter, shape in shapes.items())
    document = camera_info((width, height), name, model, *matrices)
    if any(region.values()):
        document["roi"] = region
    return yaml_text(document).encode()


_EXPECTED: Final = "a calibration of a stereo endoscope (INI with StereoLeft and StereoRight)"
_SECTIONS: Final = {"left": "StereoLeft", "right": "StereoRight"}
_REQUIRED: Final = 5  # coefficients of the distortion; further ones are zero if they are missing
_COEFFICIENTS: Final = 8


def read_stereo_ini(path: Path, side: Side) -> tuple[bytes, tuple[str, ...]]:
    """Read the camera of an eye, as the bytes of a camera file of raw images, and notes on how it was read.

    The file of the right eye states ``right_from_left``.

    Raises
    ------
    InputError
        The file is not readable, larger than 1 MB, or no INI file; a section or key is missing or its value is wrong.
    """
    ini = ConfigParser(interpolation=None, inline_comment_prefixes=("#", ";"))
    text = read_text(path, expected=_EXPECTED, largest=_LARGEST)
    try:
        ini.read_string(text)
    except IniError as error:
        raise InputError(f"{path}: expected {_EXPECTED}, got no valid INI ({' '.join(str(error).split())})") from None
    for name in _SECTIONS.values():
        if not ini.has_section(name):
            raise InputError(f"{path}: {name}: expected this section, got {listed(ini.sections()) or 'none'}")
    section = ini[_SECTIONS[side]]
    where = f"{path}: {section.name}"
    size = [take_length(where, key, section.get(key)) for key in ("res_x", "res_y")]
    focal = [_number(where, section, key) for key in ("fc_x", "fc_y", "cc_x", "cc_y")]
    keys = [f"kc_{k}" for k in range(_COEFFICIENTS)]
    lens = [_number(where, section, key) for key in keys if key in section or key in keys[:_REQUIRED]]
    rational = any(lens[_REQUIRED:])
    distortion = (*lens, *(0.0,) * (_COEFFICIENTS - len(lens)))[: _COEFFICIENTS if rational else _REQUIRED]
    model = "rational_polynomial" if rational else "plumb_bob"
    try:
        camera = Camera(size[0], size[1], focal[0], focal[1], focal[2], focal[3], distortion, model)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    if side == "left":
        return camera_info_text(camera, side).encode(), ()
    stated = {name: [_number(where, section, f"{name}_{k}") for k in range(n)] for name, n in (("R", 9), ("T", 3))}
    pose, notes = pose_of_storage(where, stated, rectified=False)
    return camera_info_text(camera, side, right_from_left=pose).encode(), notes


def _number(where: str, section: SectionProxy, key: str) -> float:
    """Return a key's number; InputError if it is missing or no finite number."""
    value = as_number(section.get(key))
    if value is None or not np.isfinite(value):
        raise InputError(f"{where}: {key}: expected a finite number, got {shown(section.get(key))}")
    return value
