"""Export of ``camera_from_base`` as the dVRK's camera registration, ``ARM-registration-*.json``.

As with dvrk_camera_registration, there are two files. ``open-cv`` has the camera axes used in this package: x right,
y down, z forward. ``dVRK``, which the console's configuration uses as ``base-frame``, has the camera axes x left, y up,
z forward: ``camera_from_base`` is multiplied by diag(-1, -1, 1, 1) from the left. Both transforms map points from the
frame of the arm's base to the camera frame, in m.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.io.atomic import json_text

DVRK_FROM_OPEN_CV: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Transform from OpenCV's camera axes to the dVRK's, which have x and y reversed."""


def registration_files(camera_from_base: NDArray[np.float64], names: FrameNames) -> dict[str, str]:
    """Return the texts of both files by file name, from ``camera_from_base`` (4, 4) in OpenCV's camera axes, m."""
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
    """Return the text of one file."""
    rows = (camera_from_base + 0.0).tolist()  # turns -0.0 into 0.0
    return json_text({"base-frame": {"reference-frame": camera, "transform": rows}, "convention": convention})
