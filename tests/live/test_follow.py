"""`dvrk-cmaes live` on the bundled session, over a websocket of 127.0.0.1."""

from __future__ import annotations

import base64
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from helpers.commands import run_command
from helpers.fake_rclpy import Bus
from helpers.made_recordings import BEGIN, SECOND
from helpers.rosbridge_server import RosbridgeServer, wait_for
from scipy.spatial.transform import Rotation

from dvrk_cmaes import prepare
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.live.follow import LiveSetup, follow
from dvrk_cmaes.live.inputs import InputTopics
from dvrk_cmaes.live.rosbridge import RosbridgeConnection

DEMO = bundled_path("demo")
TOPICS = InputTopics("/left/image", "/left/camera_info", ("/PSM1/measured_js",), "/left/mask/compressed")
POSE, OVERLAY = "/dvrk_cmaes/PSM1/camera_from_root", "/dvrk_cmaes/PSM1/overlay/compressed"


def header(k: int) -> dict[str, Any]:
    seconds, rest = divmod(BEGIN + k * SECOND // 10, SECOND)
    return {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": "left"}


def camera_info() -> dict[str, Any]:
    """Give the demo's camera as a message of ROS 2."""
    document = yaml.safe_load((DEMO / "camera.yaml").read_text())
    return {
        "header": header(0),
        "width": document["image_width"],
        "height": document["image_height"],
        "distortion_model": "plumb_bob",
        "d": document["distortion_coefficients"]["data"],
        "k": document["camera_matrix"]["data"],
    }


def send_frame(server: RosbridgeServer, k: int, *, masked: bool = True) -> None:
    """Send a frame of the demo with its image, its mask if ``masked``, and its readings, at the k-th time."""
    files = read_session(DEMO).frames[1]
    assert files.image is not None
    assert files.mask is not None
    readings = {"name": list(files.readings), "position": list(files.readings.values())}
    server.send("/PSM1/measured_js", {"header": header(k), **readings, "velocity": [], "effort": []})
    pixels = cv2.imread(str(files.image))
    size = {"width": pixels.shape[1], "height": pixels.shape[0], "step": 3 * pixels.shape[1], "encoding": "bgr8"}
    server.send("/left/image", {"header": header(k), **size, "data": base64.b64encode(pixels.tobytes()).decode()})
    if masked:
        mask = base64.b64encode(Path(files.mask).read_bytes()).decode()
        server.send("/left/mask/compressed", {"header": header(k), "format": "png", "data": mask})


@pytest.mark.parametrize("masked", [True, False], ids=["by masks", "by images"])
def test_pose_of_known_frame_is_published(masked: bool) -> None:
    server, lines = RosbridgeServer(), list[str]()
    server.start()
    connection = RosbridgeConnection("127.0.0.1", server.port, lines.append)
    assert connection.open(60)
    stop = threading.Event()
    topics = TOPICS if masked else replace(TOPICS, mask=None)
    setup = LiveSetup(topics, FrameNames(), prepare("lnd"), lag=0.0, overlay=True)
    thread = threading.Thread(target=follow, args=(setup, connection, lines.append, stop), daemon=True)
    thread.start()
    wait_for(lambda: len(server.subscribed) == (4 if masked else 3))
    server.send("/left/camera_info", camera_info())
    wait_for(lambda: any(line.startswith("camera: 640 x 480 px") for line in lines))
    for k in range(1, 200):
        send_frame(server, k, masked=masked)
        wait_for(lambda k=k: len(server.received.get(OVERLAY, [])) == k)  # type: ignore[misc]
        if len(server.received.get(POSE, [])) == 2:
            break
    stop.set()
    thread.join(60)
    connection.close()
    server.stop()
    truth = read_session(DEMO).truth.frames["0001"].camera_from_root
    for _, message in server.received[POSE]:
        pose = message["pose"]
        turn = Rotation.from_quat([pose["orientation"][axis] for axis in "xyzw"])
        assert np.linalg.norm([pose["position"][axis] for axis in "xyz"] - truth[:3, 3]) < 2e-3
        assert np.degrees((turn.inv() * Rotation.from_matrix(truth[:3, :3])).magnitude()) < 10
    drawn = cv2.imdecode(
        np.frombuffer(base64.b64decode(server.received[OVERLAY][0][1]["data"]), np.uint8), cv2.IMREAD_COLOR
    )
    assert drawn.shape == (480, 640, 3)
    assert server.refused == []


def test_command_ends_after_seconds_without_camera(capsys: pytest.CaptureFixture[str]) -> None:
    server = RosbridgeServer()
    server.start()
    ran = run_command(capsys, "live", "--image-topic", "/left/image", "--port", server.port, "--seconds", 0.5)
    server.stop()
    assert ran.code == 0
    assert ran.err.startswith(f"dvrk-cmaes: rosbridge 127.0.0.1:{server.port}: ")
    assert ran.out == "0 images followed, 0 results published, 0 refused\n"


def test_node_of_ros_2_is_used_on_request(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    bus = Bus()
    bus.install(monkeypatch)
    ran = run_command(capsys, "live", "--image-topic", "/left/image", "--via", "rclpy", "--seconds", 0.5)
    assert (ran.code, ran.err) == (0, "")
    assert set(bus.receivers) == {"/left/image", "/left/camera_info", "/PSM1/measured_js", "/PSM1/jaw/measured_js"}


def test_wrong_options_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(capsys, "live", "--image-topic", "/i", "--port", 0).refusal == (
        "--port: expected 1 to 65535, got 0"
    )
    assert run_command(capsys, "live", "--image-topic", "/i", "--seconds", 0).refusal == (
        "--seconds: expected a time above 0, got 0"
    )
    assert run_command(capsys, "live", "--image-topic", "/i", "--camera-frame", "/left").refusal == (
        "--camera-frame: expected a name as tf2 knows them, without a leading slash, got '/left'"
    )
