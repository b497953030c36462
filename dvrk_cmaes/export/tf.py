"""Export of ``camera_from_base`` as a ROS 2 static transform; the parent is the camera frame, the child the base."""

from __future__ import annotations

import shlex

from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.geometry import Float64, quaternion_xyzw


def publisher_command(parent_from_child: Float64, parent: str, child: str) -> str:
    """Return the shell command, one line, that publishes the transform (translation in m, quaternion xyzw)."""
    values = [*parent_from_child[:3, 3].tolist(), *quaternion_xyzw(parent_from_child)]
    options = (
        f"--{name} {value:.12f}" for name, value in zip(("x", "y", "z", "qx", "qy", "qz", "qw"), values, strict=True)
    )
    return " ".join(
        (
            "ros2 run tf2_ros static_transform_publisher",
            *options,
            f"--frame-id {shlex.quote(parent)} --child-frame-id {shlex.quote(child)}",
        )
    )


def exported(request: ExportRequest) -> Exported:
    """Export ``camera_from_base``; InputError if the source has none.

    Of an endoscope that moved and whose arm is read, the transforms that stay are exported in its place: the camera in
    the endoscope's tip, and the bases of the session's arms in that of the endoscope's arm.
    """
    base, names = request.source.base(), request.names
    names.check_tf()
    transforms = {names.arm: (base.camera_from_base, names.camera, names.base)}
    if base.tip_from_camera is not None and base.ecm_from_base is not None:
        transforms = {
            "ECM-tip": (base.tip_from_camera, "ECM_tip", names.camera),
            names.arm: (base.ecm_from_base, "ECM_base", names.base),
            **{arm: (other, "ECM_base", f"{arm}_base") for arm, other in base.others.items()},
        }
    texts = {f"{name}-static-transform.sh": f"{publisher_command(*each)}\n" for name, each in transforms.items()}
    return Exported.of_texts(texts, base=base)
