"""`dvrk-cmaes live` on the bundled session, over a websocket of 127.0.0.1."""

from __future__ import annotations

import base64
import sys
import threading
from collections.abc import Iterator
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from examples.play_session import RosbridgeServer
from helpers.commands import run_command
from helpers.fake_rclpy import Bus
from helpers.made_recordings import BEGIN, SECOND
from helpers.waiting import wait_for
from scipy.spatial.transform import Rotation

from dvrk_cmaes import prepare
from dvrk_cmaes.cli import live as cli_live
from dvrk_cmaes.cli.terminal import note
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.live.follow import ArmSetup, LiveSetup, follow
from dvrk_cmaes.live.inputs import EyeTopics, InputTopics
from dvrk_cmaes.live.rosbridge import RosbridgeConnection

BODY = prepare("lnd")
DEMO = bundled_path("demo")
READINGS = {"PSM1": ("/PSM1/measured_js",)}
MASKED = {"left": EyeTopics.of("/left/image", masks={"PSM1": "/left/mask/compressed"})}
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
    topics = InputTopics(MASKED if masked else {"left": EyeTopics.of("/left/image")}, READINGS)
    setup = LiveSetup(topics, (ArmSetup(FrameNames(), BODY),), lag=0.0, overlay=True)
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


@pytest.fixture
def server() -> Iterator[RosbridgeServer]:
    server = RosbridgeServer()
    server.start()
    yield server
    server.stop()


@pytest.mark.parametrize(
    ("topics", "said"),
    [
        ({}, "/left/image: no message; /left/camera_info: no message; --wait waits for them"),
        (
            {"/left/image": "sensor_msgs/msg/CompressedImage", "/right/image_raw": "sensor_msgs/msg/Image"},
            "/left/image: expected sensor_msgs/Image, got sensor_msgs/msg/CompressedImage; /left/camera_info: no such "
            "topic; there are /right/image_raw; --wait waits for them",
        ),
        (
            {"/left/image": "sensor_msgs/msg/Image", "/left/camera_info": "sensor_msgs/msg/CameraInfo"},
            "/left/image: no message from its publisher; /left/camera_info: no message from its publisher; there are "
            "/left/image, /left/camera_info; --wait waits for them",
        ),
    ],
)
def test_command_that_gets_no_image_says_what_to_check(
    server: RosbridgeServer, capsys: pytest.CaptureFixture[str], topics: dict[str, str], said: str
) -> None:
    server.topics = topics
    ran = run_command(capsys, "live", "--image-topic", "/left/image", "--port", server.port, "--seconds", 1.5)
    name = f"rosbridge 127.0.0.1:{server.port}"
    assert (ran.code, ran.out) == (1, "")
    assert ran.err.splitlines()[-1] == f"dvrk-cmaes: no image: {name}: {said}"


def test_command_without_a_server_says_so(
    server: RosbridgeServer, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    server.stop()  # a port that is free
    said = f"no image: rosbridge 127.0.0.1:{server.port}: no connection: is it running there"
    ran = run_command(capsys, "live", "--image-topic", "/left/image", "--port", server.port, "--seconds", 0.5)
    setup = LiveSetup(InputTopics({"left": EyeTopics.of("/left/image")}, READINGS), (ArmSetup(FrameNames(), BODY),))
    with pytest.raises(DvrkCmaesError, match=said):
        follow(setup, RosbridgeConnection("127.0.0.1", server.port, print), print, threading.Event(), begin_within=0.2)
    server.start()
    assert ran.code == 1
    assert said in ran.err
    monkeypatch.setattr(cli_live, "shown_state", partial(cli_live.shown_state, lines=0.3))
    waited = run_command(
        capsys, "live", "--image-topic", "/left/image", "--port", server.port, "--wait", "--seconds", 2
    )
    assert waited.code == 1
    assert waited.err.count("dvrk-cmaes: 0 images; waiting for the camera\n") > 2


def test_state_is_renewed_in_one_line_of_a_terminal_below_other_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with cli_live.shown_state(renewed=0.0) as shown:
        shown(lambda: "1 image")
        shown(lambda: "2 images")
        note("a line")
        shown(lambda: "3 images")
    written = terminal.getvalue()
    assert written.index("2 images") < written.index("dvrk-cmaes: a line\n") < written.index("3 images")
    assert "\n" not in written[: written.index("dvrk-cmaes: a line")]
    assert "\x1b[2K" in written


def test_node_of_ros_2_is_used_on_request(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    bus = Bus()
    bus.install(monkeypatch)
    ran = run_command(capsys, "live", "--image-topic", "/left/image", "--via", "rclpy", "--seconds", 0.5)
    assert ran.code == 1
    assert ran.err.startswith("dvrk-cmaes: no image: ROS 2: /left/image: no message from its publisher")
    assert set(bus.receivers) == {
        "/left/image",
        "/left/camera_info",
        "/PSM1/measured_js",
        "/PSM1/jaw/measured_js",
        "/ECM/measured_js",
    }


def test_both_arms_and_eyes_are_subscribed_with_their_own_topics(
    server: RosbridgeServer, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arms = ("--psm", "PSM1", "PSM2", "--joints-topic", "/a/js", "/b/js", "--seconds", 1, "--out", tmp_path / "out")
    eyes = ("--image-topic", "/l/image_raw/compressed", "--right-image-topic", "/r/image_raw/compressed")
    masks = ("--mask-topic", "/l/a", "/l/b", "--right-mask-topic", "/r/a", "/r/b")
    ran = run_command(capsys, "live", *arms, *eyes, *masks, "--port", server.port)
    assert ran.code == 1
    assert not (tmp_path / "out").exists()  # since nothing was found
    images = {f"/{eye}/image_raw/compressed" for eye in "lr"} | {f"/{eye}/{arm}" for eye in "lr" for arm in "ab"}
    readings = {"/a/js", "/b/js", "/PSM1/jaw/measured_js", "/PSM2/jaw/measured_js", "/ECM/measured_js"}
    assert set(server.subscribed) == images | readings | {"/l/camera_info", "/r/camera_info"}
    poses = {f"/dvrk_cmaes/{arm}/camera_from_root" for arm in ("PSM1", "PSM2")}
    assert poses <= set(server.advertised)


@pytest.mark.parametrize(
    ("options", "refusal"),
    [
        ((), "--image-topic: expected the topic of the images, got none"),
        (
            ("--image-topic", "/i", "--psm", "PSM1", "PSM2"),
            "--mask-topic: expected a topic for each of several arms: colours do not tell them apart",
        ),
        (
            ("--image-topic", "/i", "--psm", "PSM1", "PSM2", "--mask-topic", "/m"),
            "--mask-topic: expected a topic for each of PSM1, PSM2, got /m",
        ),
        (("--image-topic", "/i", "--psm", "PSM1", "PSM1"), "--psm: expected different arms, got PSM1, PSM1"),
        (
            ("--image-topic", "/i", "--right-mask-topic", "/m"),
            "--right-image-topic: expected the topic of the right eye's images, got none",
        ),
        (
            ("--image-topic", "/i", "--right-image-topic", "/j", "--mask-topic", "/m"),
            "--right-mask-topic: expected masks of both eyes or of neither, got those of one",
        ),
        (
            ("--image-topic", "/i", "--camera-right", "c.yaml"),
            "--camera-right: expected --camera and --right-image-topic with it",
        ),
        (
            ("--image-topic", "/i", "--psm", "A", "B", "--mask-topic", "/m", "/n", "--session", "session.json"),
            "--session: expected a folder with a session.json for each arm, got session.json",
        ),
        (
            ("--image-topic", "/i", "--rehearse", "s"),
            "--rehearse: no longer an option; use `dvrk-cmaes track --causal` (see dvrk-cmaes live --help)",
        ),
    ],
)
def test_options_that_do_not_fit_together_are_refused(
    capsys: pytest.CaptureFixture[str], options: tuple[str, ...], refusal: str
) -> None:
    assert run_command(capsys, "live", *options).refusal == refusal


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
