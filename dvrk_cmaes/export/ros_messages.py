"""ROS messages as plain values, with the field names of ROS 2, independent of how they are recorded or sent.

Times are in ns, lengths in m, angles in rad; quaternions are x, y, z, w.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from dvrk_cmaes.geometry import Float64, quaternion_xyzw
from dvrk_cmaes.joints.interpolation import NANOSECONDS

POSE_STAMPED: Final = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE: Final = "geometry_msgs/msg/PoseWithCovarianceStamped"
JOINT_STATE: Final = "sensor_msgs/msg/JointState"
TF_MESSAGE: Final = "tf2_msgs/msg/TFMessage"


@dataclass(frozen=True, eq=False)
class RosMessage:
    """A message: its topic, its type as named in ROS 2, its time, ns, and its fields, with mappings inside."""

    topic: str
    kind: str
    time: int
    fields: dict[str, Any]


def header(time: int, frame_id: str = "") -> dict[str, Any]:
    """Return the fields of a std_msgs/Header."""
    seconds, rest = divmod(time, NANOSECONDS)
    return {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": frame_id}


def pose_message(topic: str, time: int, frame_id: str, pose: Float64) -> RosMessage:
    """Return the PoseStamped of a pose (4, 4) in the frame ``frame_id``."""
    position, orientation = _vector_and_quaternion(pose)
    fields = {"header": header(time, frame_id), "pose": {"position": position, "orientation": orientation}}
    return RosMessage(topic, POSE_STAMPED, time, fields)


def uncertain_pose_message(
    topic: str, time: int, frame_id: str, pose: Float64, covariance: Float64 | None
) -> RosMessage:
    """Return the PoseWithCovarianceStamped of a pose (4, 4) in the frame ``frame_id``.

    ``covariance`` (6 + J, 6 + J) is along and about the axes of that frame, m and rad, as ROS has it; zeros stand for
    one that is not known.
    """
    plain = pose_message(topic, time, frame_id, pose).fields
    matrix = np.zeros((6, 6)) if covariance is None else covariance[:6, :6]
    fields = {"header": plain["header"], "pose": {"pose": plain["pose"], "covariance": matrix.ravel().tolist()}}
    return RosMessage(topic, POSE_WITH_COVARIANCE, time, fields)


def tf_message(time: int, poses: Mapping[tuple[str, str], Float64]) -> RosMessage:
    """Return the message on ``/tf`` of poses (4, 4), by the names of the parent and the child frame."""
    transforms = []
    for (parent, child), pose in poses.items():
        translation, rotation = _vector_and_quaternion(pose)
        transforms.append(
            {
                "header": header(time, parent),
                "child_frame_id": child,
                "transform": {"translation": translation, "rotation": rotation},
            }
        )
    return RosMessage("/tf", TF_MESSAGE, time, {"transforms": transforms})


def joint_message(topic: str, time: int, joints: Mapping[str, float]) -> RosMessage:
    """Return the JointState of joint positions by name, rad or m."""
    fields = {
        "header": header(time),
        "name": list(joints),
        "position": list(joints.values()),
        "velocity": [],
        "effort": [],
    }
    return RosMessage(topic, JOINT_STATE, time, fields)


def _vector_and_quaternion(pose: Float64) -> tuple[dict[str, float], dict[str, float]]:
    """Return the fields of the position and of the orientation of a pose (4, 4)."""
    position = dict(zip("xyz", pose[:3, 3].tolist(), strict=True))
    return position, dict(zip("xyzw", quaternion_xyzw(pose), strict=True))
