"""Publication of a followed instrument: its pose, joints, status and overlay.

Topics, in the namespace ``/dvrk_cmaes/ARM``: ``camera_from_root`` (PoseWithCovarianceStamped), ``measured_js``
(JointState, the corrected joints) and ``overlay/compressed`` (CompressedImage); and ``/tf`` and ``/diagnostics``. All
have the time of the image. A lost instrument has a status, and no pose and joints. ``/tf`` has the root link in the
camera, and with a pose that is ok the arm's base.
"""

from __future__ import annotations

import base64
import time as clock
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import cv2

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.draw.canvas import Canvas
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.export.ros_messages import (
    POSE_WITH_COVARIANCE,
    RosMessage,
    header,
    joint_message,
    tf_message,
    uncertain_pose_message,
)
from dvrk_cmaes.export.ros_topics import FOUND
from dvrk_cmaes.geometry import Image
from dvrk_cmaes.live.connection import Connection
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.silhouette import Body, Renderer

_DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
_COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
_LEVELS: Final = {"ok": 0, "doubtful": 1, "lost": 2}  # OK, WARN and ERROR
_JPEG_QUALITY: Final = 80


class Outputs:
    """Publishes results on a connection; ``root_link`` names the child frame in tf, after the arm.

    With an instrument ``drawn``, each image of the first camera is published with the outline of its silhouette.
    """

    def __init__(
        self, connection: Connection, names: FrameNames, root_link: str = "roll_link", drawn: Body | None = None
    ) -> None:
        names.check_tf()
        self._connection = connection
        self._names, self.drawn = names, drawn
        self._child = f"{names.arm}_{root_link}"
        self._namespace = f"{FOUND}/{names.arm}"
        topics = {
            f"{self._namespace}/camera_from_root": POSE_WITH_COVARIANCE,
            f"{self._namespace}/measured_js": "sensor_msgs/msg/JointState",
            f"{self._namespace}/overlay/compressed": _COMPRESSED,
            "/tf": "tf2_msgs/msg/TFMessage",
            "/diagnostics": _DIAGNOSTICS,
        }
        for topic, kind in topics.items():
            connection.advertise(topic, kind)

    def begin(self, rig: Rig) -> None:
        """Publish what is found by other cameras from now on."""
        self._renderer = None if self.drawn is None else Renderer(self.drawn, rig.camera, threads=1)

    def publish(
        self, time: int, result: TrackResult, age: float, silent: Sequence[str], image: Image | None, calibration: str
    ) -> bool:
        """Publish the result of the image of a time, ns; returns whether everything was sent.

        ``age`` is that of the image, s. ``silent`` are topics that have stopped; ``image`` is (H, W, 3), BGR, if an
        overlay is drawn over it. ``calibration`` says how far the arm's base is known.
        """
        values = {
            "reasons": "; ".join(result.reasons),
            "remarks": "; ".join(result.remarks),
            "age_ms": f"{1e3 * age:.1f}",
            "silent_topics": " ".join(silent),
            **({"calibration": calibration} if calibration else {}),
        }
        level = max(_LEVELS.get(result.status, 2), 1 if silent else 0)
        messages = [*self._found(time, result), self._status_message(time, level, result.status, values)]
        if image is not None and self._renderer is not None:
            messages.append(self._overlay(time, image, replace(result, renderer=self._renderer), calibration))
        return sum(map(self._send, messages)) == len(messages)

    def publish_state(self, state: str, reason: str, silent: Sequence[str]) -> bool:
        """Publish a status without a result: why there is no pose now; returns whether it was sent."""
        values = {"reasons": reason, "silent_topics": " ".join(silent)}
        return self._send(self._status_message(clock.time_ns(), 2, state, values))

    def _send(self, message: RosMessage) -> bool:
        """Publish a message, with times as in ROS 1 where that is answered; returns whether it was sent."""
        fields = _as_ros1(message.fields) if self._connection.ros1 else message.fields
        return self._connection.publish(message.topic, fields)

    def _found(self, time: int, result: TrackResult) -> Iterator[RosMessage]:
        """Yield the messages of a pose and joints that were found."""
        pose = result.camera_from_root
        if pose is None or result.status == "lost":
            return
        topic, covariance = f"{self._namespace}/camera_from_root", result.covariance_in_camera()
        yield uncertain_pose_message(topic, time, self._names.camera, pose, covariance)
        children = {(self._names.camera, self._child): pose}
        if result.status == "ok" and result.camera_from_base is not None:
            children[self._names.camera, self._names.base] = result.camera_from_base
        yield tf_message(time, children)
        if result.joints:
            yield joint_message(f"{self._namespace}/measured_js", time, result.joints)

    def _status_message(self, time: int, level: int, text: str, values: Mapping[str, str]) -> RosMessage:
        """Return the message of a status of some level with values by key."""
        status = {
            "level": level,
            "name": f"dvrk_cmaes: {self._names.arm}",
            "message": text,
            "hardware_id": self._names.arm,
            "values": [{"key": key, "value": value} for key, value in values.items()],
        }
        return RosMessage("/diagnostics", _DIAGNOSTICS, time, {"header": header(time), "status": [status]})

    def _overlay(self, time: int, image: Image, result: TrackResult, state: str) -> RosMessage:
        """Return the message of an image with the outline of a silhouette, the status and ``state``, a JPEG."""
        canvas = Canvas(result.overlay(image), 1.0)
        for line, text in enumerate((": ".join([result.status, *result.reasons[:1]]), state)):
            canvas.text(text, (8.0, 14.0 + 16.0 * line), rim=True)
        _, data = cv2.imencode(".jpg", canvas.image, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))
        fields = {
            "header": header(time, self._names.camera),
            "format": "jpeg",
            "data": base64.b64encode(data.tobytes()).decode("ascii"),
        }
        return RosMessage(f"{self._namespace}/overlay/compressed", _COMPRESSED, time, fields)


def _as_ros1(value: Any) -> Any:
    """Return the fields of a message with times as in ROS 1."""
    if isinstance(value, list):
        return [_as_ros1(element) for element in value]
    if not isinstance(value, dict):
        return value
    if set(value) == {"sec", "nanosec"}:
        return {"secs": value["sec"], "nsecs": value["nanosec"]}
    return {key: _as_ros1(inner) for key, inner in value.items()}
