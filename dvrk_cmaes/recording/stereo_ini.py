"""Reader of a stereo endoscope's calibration as an INI file, as SurgPose has it (StereoCalibrationDVRK.ini).

``[StereoLeft]`` and ``[StereoRight]`` state the size ``res_x``, ``res_y``, the intrinsics ``fc_x``,
``fc_y``, ``cc_x``, ``cc_y``, px, and the distortion ``kc_0`` to ``kc_7`` in OpenCV's order. ``[StereoRight]`` has the
pose between the cameras, too: ``R_0`` to ``R_8`` in rows and ``T_0`` to ``T_2``, m or mm, from the left camera to the
right one.
"""

from __future__ import annotations

from configparser import ConfigParser, SectionProxy
from configparser import Error as IniError
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera.fields import Side, as_number, take_length
from dvrk_cmaes.camera.stereo import pose_of_storage
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.io.yaml_file import yaml_text
from dvrk_cmaes.recording.camera import with_pose

_EXPECTED: Final = "a calibration of a stereo endoscope (INI with StereoLeft and StereoRight)"
_LARGEST: Final = 100_000  # bytes
_SECTIONS: Final = {"left": "StereoLeft", "right": "StereoRight"}
_REQUIRED: Final = 5  # coefficients of the distortion; further ones are zero if they are missing
_COEFFICIENTS: Final = 8


def read_stereo_ini(path: Path, side: Side) -> tuple[bytes, tuple[str, ...]]:
    """Read the camera of an eye, as the bytes of a camera file of raw images, and notes on how it was read.

    The file of the right eye states ``right_from_left``.

    Raises
    ------
    InputError
        The file is not readable, larger than 100 kB, or no INI file; a section or key is missing or its value is wrong.
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
    camera = _camera(path, ini[_SECTIONS[side]], side)
    if side == "left":
        return yaml_text(camera).encode(), ()
    pose, notes = _pose(path, ini[_SECTIONS[side]])
    return with_pose(camera, pose), notes


def _camera(path: Path, section: SectionProxy, side: Side) -> dict[str, Any]:
    """Return the camera of a section as a document in the format of ROS' camera_calibration."""
    where = f"{path}: {section.name}"
    width, height = (take_length(where, key, section.get(key)) for key in ("res_x", "res_y"))
    fx, fy, cx, cy = (_number(where, section, key) for key in ("fc_x", "fc_y", "cc_x", "cc_y"))
    keys = [f"kc_{k}" for k in range(_COEFFICIENTS)]
    distortion = [_number(where, section, key) for key in keys if key in section or key in keys[:_REQUIRED]]
    distortion += [0.0] * (_COEFFICIENTS - len(distortion))
    rational = any(distortion[_REQUIRED:])
    distortion = distortion if rational else distortion[:_REQUIRED]
    return {
        "image_width": width,
        "image_height": height,
        "camera_name": side,
        "camera_matrix": {"rows": 3, "cols": 3, "data": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]},
        "distortion_model": "rational_polynomial" if rational else "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": len(distortion), "data": distortion},
    }


def _pose(path: Path, section: SectionProxy) -> tuple[Float64, tuple[str, ...]]:
    """Return ``right_from_left`` (4, 4), m, of the right eye's section, and notes on its unit."""
    where = f"{path}: {section.name}"
    rotation = [_number(where, section, f"R_{k}") for k in range(9)]
    translation = [_number(where, section, f"T_{k}") for k in range(3)]
    return pose_of_storage(where, {"R": rotation, "T": translation}, rectified=False)


def _number(where: str, section: SectionProxy, key: str) -> float:
    """Return a key's number; InputError if it is missing or no finite number."""
    value = as_number(section.get(key))
    if value is None or not np.isfinite(value):
        raise InputError(f"{where}: {key}: expected a finite number, got {shown(section.get(key))}")
    return value
