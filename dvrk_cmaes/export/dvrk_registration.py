"""Export of ``camera_from_base`` to the dVRK: the files of dvrk_camera_registration, or the fixed setup joints.

``ARM-registration-open-cv.json``, which dvrk_camera_registration reads back, has the camera axes used in this package:
x right, y down, z forward. The dVRK's camera axes are x left, y up, z forward: ``camera_from_base`` is multiplied by
diag(-1, -1, 1, 1) from the left.

- For a camera on a stand, ``ARM-registration-dVRK.json`` is the entry of an arm in the dVRK's configuration: in
  ``system.json`` of version 2.4 ``base_frame``, in ``console.json`` up to 2.3 ``base-frame``. It has no other keys,
  since the dVRK refuses keys that it does not know.
- For a camera held by an endoscope arm (ECM), ``suj-fixed.json`` describes setup joints that do not move: the pose of
  the arm's base in that of the ECM, so that it holds while the ECM moves.

All transforms are in m.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from dvrk_cmaes.export.request import DvrkVersion, Exported, ExportRequest
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.setup_joints import SETUP, setup_text
from dvrk_cmaes.io.json_file import json_text

DVRK_FROM_OPEN_CV: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Transform from OpenCV's camera axes to the dVRK's, which have x and y reversed."""


_KEYS: Final[dict[DvrkVersion, tuple[str, str]]] = {
    "2.4": ("base_frame", "reference_frame"),
    "2.3": ("base-frame", "reference-frame"),
}
_OPEN_CV_KEYS: Final = _KEYS["2.3"]  # those that dvrk_camera_registration reads with every version of the dVRK


def exported(request: ExportRequest) -> Exported:
    """Export ``camera_from_base``; InputError if the source has none.

    The arm's base in that of the endoscope's arm follows from that arm's pose, if it is given, or else from a session
    with an endoscope that moved, if that determines it, as of the session's other arms.
    """
    base, names = request.source.base(), request.names
    stated = "OpenCV: camera_from_base, m; camera x right, y down, z forward"
    open_cv = {**_entry(base.camera_from_base, names.camera, _OPEN_CV_KEYS), "convention": stated}
    files = {f"{names.arm}-registration-open-cv.json": json_text(open_cv)}
    in_dvrk_axes = DVRK_FROM_OPEN_CV @ base.camera_from_base
    ecm_from_base, others = base.ecm_from_base, base.others
    if request.ecm_pose is not None:
        ecm_from_base, others = request.ecm_pose @ in_dvrk_axes, {}
    if ecm_from_base is None:
        entry = _entry(in_dvrk_axes, names.camera, _KEYS[request.dvrk_version])
        files[f"{names.arm}-registration-dVRK.json"] = json_text(entry)
    else:
        files[SETUP] = setup_text({"ECM": np.eye(4), names.arm: ecm_from_base, **others})
    return Exported.of_texts(files, base=base)


def _entry(transform: Float64, camera: str, keys: tuple[str, str]) -> dict[str, Any]:
    """Return the entry of an arm's base frame."""
    base_frame, reference_frame = keys
    return {base_frame: {reference_frame: camera, "transform": (transform + 0.0).tolist()}}  # 0.0 for -0.0
