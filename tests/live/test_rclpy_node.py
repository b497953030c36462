"""The node of ROS 2, with an rclpy of this process: topics, types and the conversion of messages both ways."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from helpers.fake_rclpy import Bus, get_message
from helpers.made_recordings import ARM, BEGIN, SECOND, pixels, sweep
from helpers.transforms import moved

from dvrk_cmaes import InputError
from dvrk_cmaes.export.ros_messages import header, joint_message, pose_message, tf_message
from dvrk_cmaes.live.inputs import EyeTopics, Inputs, InputTopics
from dvrk_cmaes.live.rclpy_node import RclpyConnection, filled_message, plain_fields

POSE = moved(np.eye(4), [0.01, 0.02, 0.1, 0.3, -0.4, 0.5])
MESSAGES = [
    pose_message("/p", BEGIN, "camera", POSE),
    tf_message(BEGIN, {("camera", "PSM1_roll_link"): POSE}),
    joint_message("/j", BEGIN, {"wrist_pitch": 0.1, "jaw": 0.2}),
]


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Bus:
    bus = Bus()
    bus.install(monkeypatch)
    return bus


@pytest.mark.parametrize("message", MESSAGES, ids=lambda one: one.kind.rpartition("/")[2])
def test_message_is_filled_and_read_back(message: Any) -> None:
    filled = filled_message(get_message(message.kind)(), message.fields, get_message)
    assert plain_fields(filled) == message.fields


def test_bytes_and_levels_have_types_of_ros_2() -> None:
    image = filled_message(
        get_message("sensor_msgs/msg/CompressedImage")(), {"data": base64.b64encode(b"abc").decode()}, get_message
    )
    assert plain_fields(image)["data"] == b"abc"
    status = filled_message(get_message("diagnostic_msgs/msg/DiagnosticStatus")(), {"level": 2}, get_message)
    assert status.level == b"\x02"


def test_received_image_and_readings_reach_inputs(bus: Bus) -> None:
    lines: list[str] = []
    connection = RclpyConnection(lines.append)
    inputs = Inputs(InputTopics({"left": EyeTopics.of("/left/image")}, {"PSM1": ("/PSM1/measured_js",)}), lines.append)
    inputs.subscribe(connection)
    connection.open(1.0)
    assert connection.topics(0.0) == {"/left/image": "sensor_msgs/msg/Image", "/tf": "tf2_msgs/msg/TFMessage"}
    seen = pixels(3)
    sent: dict[str, Mapping[str, Any]] = {
        "/left/image": {
            "header": header(BEGIN, "left"),
            "width": seen.shape[1],
            "height": seen.shape[0],
            "step": 3 * seen.shape[1],
            "encoding": "bgr8",
            "data": base64.b64encode(seen.tobytes()).decode(),
        },
        "/PSM1/measured_js": {"header": header(BEGIN), "name": list(ARM), "position": sweep(BEGIN + SECOND)},
        "/left/camera_info": {
            "width": 64,
            "height": 48,
            "distortion_model": "plumb_bob",
            "d": [0.0] * 5,
            "k": [80.0, 0.0, 31.5, 0.0, 80.0, 22.0, 0.0, 0.0, 1.0],
        },
    }
    for topic, fields in sent.items():
        kind, receive = bus.receivers[topic]
        receive(filled_message(kind(), fields, get_message))
    frame, rig = inputs.frames.take(1.0), inputs.rigs.take(1.0)
    assert frame is not None
    assert rig is not None
    assert np.array_equal(frame.decoded().images["left"], seen)
    assert rig.camera.fx == 80
    (readings,) = inputs.readings["PSM1"].take_all()
    assert list(readings.joints.values()) == pytest.approx(sweep(BEGIN + SECOND))
    bus.receivers["/left/image"][1](object())
    assert lines == [
        "/left/image: a message that cannot be read: 'object' object has no attribute 'get_fields_and_field_types'"
    ]
    connection.close()


def test_messages_are_published_on_advertised_topics(bus: Bus) -> None:
    connection = RclpyConnection(list[str]().append)
    connection.open(1.0)
    message = MESSAGES[0]
    connection.advertise("/p", message.kind)
    assert connection.publish("/p", message.fields)
    assert [plain_fields(one) for one in bus.published["/p"]] == [message.fields]
    connection.close()


def test_missing_rclpy_is_named() -> None:
    with pytest.raises(InputError, match=r"rclpy: not importable .*; source ROS 2 first, or use a rosbridge server"):
        RclpyConnection(list[str]().append)
