"""Export of ``camera_from_base`` as a ROS 2 static transform; the parent is the camera frame, the child the base."""

from __future__ import annotations

import shlex

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.geometry import quaternion_xyzw


def publisher_command(camera_from_base: NDArray[np.float64], names: FrameNames) -> str:
    """Return the shell command, one line, that publishes the transform (translation in m, quaternion xyzw)."""
    names.check_tf()
    values = [*camera_from_base[:3, 3].tolist(), *quaternion_xyzw(camera_from_base)]
    options = (
        f"--{name} {value:.12f}" for name, value in zip(("x", "y", "z", "qx", "qy", "qz", "qw"), values, strict=True)
    )
    return " ".join(
        (
            "ros2 run tf2_ros static_transform_publisher",
            *options,
            f"--frame-id {shlex.quote(names.camera)} --child-frame-id {shlex.quote(names.base)}",
        )
    )


def publisher_file(camera_from_base: NDArray[np.float64], names: FrameNames) -> dict[str, str]:
    """Return the text of a shell script with the command, by file name."""
    return {f"{names.arm}-static-transform.sh": publisher_command(camera_from_base, names) + "\n"}


def exported(request: ExportRequest) -> Exported:
    """Export ``camera_from_base``; InputError if the source has none."""
    base = request.source.base()
    return Exported.of_texts(publisher_file(base.camera_from_base, request.names), base=base)
