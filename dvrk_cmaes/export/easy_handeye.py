"""Export of ``camera_from_base`` as a calibration of easy_handeye, of type eye_on_base.

There are ``NAME.calib``, of easy_handeye2 for ROS 2, and ``NAME_eye_on_base.yaml``, of easy_handeye for ROS 1. Their
transform is ``base_from_camera``, the camera's pose in the robot's base frame, which is the inverse of the
transform in all other exports. Both publish it with the robot's base frame as parent and the camera frame as
child.
"""

from __future__ import annotations

from typing import Any

import yaml

from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.geometry import inverse, quaternion_xyzw


def exported(request: ExportRequest) -> Exported:
    """Export ``camera_from_base``; InputError if the source has none.

    easy_handeye2 reads its own from ``~/.ros2/easy_handeye2/calibrations``, easy_handeye from ``~/.ros/easy_handeye``.
    """
    base, names = request.source.base(), request.names
    names.check_tf()
    name = f"{names.arm}_camera"
    base_from_camera = inverse(base.camera_from_base)
    translation = base_from_camera[:3, 3].tolist()
    document: dict[str, dict[str, Any]] = {
        "parameters": {
            "name": name,
            "calibration_type": "eye_on_base",
            "robot_base_frame": names.base,
            "robot_effector_frame": f"{names.arm}_tool",
            "tracking_base_frame": names.camera,
            "tracking_marker_frame": f"{names.arm}_instrument",
        },
        "transform": {
            "translation": dict(zip("xyz", translation, strict=True)),
            "rotation": dict(zip("xyzw", quaternion_xyzw(base_from_camera), strict=True)),
        },
    }
    transform = document["transform"]
    ros1 = {
        "parameters": {
            "namespace": f"/{name}_eye_on_base/",
            "eye_on_hand": False,
            **{key: value for key, value in document["parameters"].items() if key.endswith("_frame")},
        },
        "transformation": {**transform["translation"], **{f"q{k}": v for k, v in transform["rotation"].items()}},
    }
    files = {f"{name}.calib": document, f"{name}_eye_on_base.yaml": ros1}
    texts = {file: yaml.safe_dump(own, sort_keys=False, allow_unicode=True) for file, own in files.items()}
    return Exported.of_texts(texts, base=base)
