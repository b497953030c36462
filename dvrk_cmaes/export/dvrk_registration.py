"""The dVRK's camera registration: ``camera_from_base`` as ``ARM-registration-*.json``.

dvrk_camera_registration writes two files. ``open-cv`` has the camera's axes as everywhere here: x right, y down,
z forward. ``dVRK`` is what the console's configuration takes as ``base-frame``: the camera seen with x left, y up,
z forward, so diag(-1, -1, 1, 1) stands on the left. Both map points of the arm's base into the camera, in m.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.io.atomic import json_text

DVRK_FROM_OPEN_CV: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
"""The dVRK's camera axes from OpenCV's: x and y the other way round."""


def registration_files(camera_from_base: NDArray[np.float64], names: FrameNames) -> dict[str, str]:
    """Texts of both files by their names, from ``camera_from_base`` (4, 4) in OpenCV's axes, m."""
    return {
        f"{names.arm}-registration-open-cv.json": _registration(
            camera_from_base, names.camera, "OpenCV: camera_from_base, m; camera x right, y down, z forward"
        ),
        f"{names.arm}-registration-dVRK.json": _registration(
            DVRK_FROM_OPEN_CV @ camera_from_base,
            names.camera,
            "dVRK: camera_from_base, m; camera x left, y up, z forward",
        ),
    }


def _registration(camera_from_base: NDArray[np.float64], camera: str, convention: str) -> str:
    rows = (camera_from_base + 0.0).tolist()  # no -0.0
    return json_text({"base-frame": {"reference-frame": camera, "transform": rows}, "convention": convention})
