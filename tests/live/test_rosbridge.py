"""The live loop over a websocket, on a server of 127.0.0.1 that sends what a robot sends."""

from __future__ import annotations

import base64
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import pytest
import roslibpy
from examples.play_session import RosbridgeServer
from helpers.live_wires import NothingBeside
from helpers.made_recordings import ARM, BEGIN, HEIGHT, SECOND, WIDTH, pixels, sweep
from helpers.waiting import wait_for
from scipy.spatial.transform import Rotation

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.live import arm as live_arm
from dvrk_cmaes.live import loop as live_loop
from dvrk_cmaes.live.arm import LiveArm
from dvrk_cmaes.live.inputs import EyeTopics, Inputs, InputTopics
from dvrk_cmaes.live.loop import LiveLoop
from dvrk_cmaes.live.outputs import Outputs
from dvrk_cmaes.live.rosbridge import RosbridgeConnection

IMAGE, CAMERA, JOINTS, JAW = (
    "/left/image_raw/compressed",
    "/left/camera_info",
    "/PSM1/measured_js",
    "/PSM1/jaw/measured_js",
)
TOPICS = InputTopics({"left": EyeTopics.of(IMAGE, CAMERA)}, {"PSM1": (JOINTS, JAW)})
FOUND = "/dvrk_cmaes/PSM1"
POSE = moved(np.eye(4), [0.01, 0.02, 0.1, 0.3, -0.4, 0.5])


@dataclass(frozen=True)
class Step:
    """A result of a step."""

    camera_from_root: np.ndarray | None
    joints: dict[str, float]
    status: str = "ok"
    reasons: Sequence[str] = ()
    remarks: tuple[str, ...] = ()
    tips: np.ndarray | None = None
    camera_from_base: np.ndarray | None = None


@dataclass
class Recorder(NothingBeside):
    """A tracker that gives the last readings as joints, and keeps what it was given."""

    readings: list[tuple[float, Mapping[str, float]]] = field(default_factory=list)
    steps: list[tuple[float, Any, Any]] = field(default_factory=list)
    lost: bool = False

    def add_readings(self, time: float, joints: Mapping[str, float]) -> None:
        self.readings.append((time, joints))

    def step(self, time: float, mask: Any = None, image: Any = None, ignore: Any = None) -> Step:
        if self.steps and time <= self.steps[-1][0]:
            raise InputError(f"time: expected more than {self.steps[-1][0]:g} s, got {time:g}")
        self.steps.append((time, mask, image))
        if self.lost:
            return Step(None, {}, "lost", ("no edge can be seen",))
        known = {name: value for _, joints in self.readings[-2:] for name, value in joints.items()}
        return Step(POSE, {name: known[name] for name in ("wrist_pitch", "jaw") if name in known})


@dataclass
class Live:
    """A loop that runs on another thread, with its server."""

    server: RosbridgeServer
    tracker: Recorder
    lines: list[str]
    connection: RosbridgeConnection
    inputs: Inputs
    loop: LiveLoop

    def received(self, topic: str) -> list[dict[str, Any]]:
        return [message for _, message in self.server.received.get(topic, [])]


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch) -> Iterator[Live]:
    """Connect a loop to a server and run it."""
    for module in (live_arm, live_loop):
        monkeypatch.setattr(module, "OLD", np.inf)  # the images' clock does not go with that of the computer
    server = RosbridgeServer()
    server.start()
    lines: list[str] = []
    connection = RosbridgeConnection("127.0.0.1", server.port, lines.append)
    tracker = Recorder()
    inputs = Inputs(TOPICS, lines.append, longest_silence=0.5)
    inputs.subscribe(connection)
    outputs = Outputs(connection, FrameNames())
    arm = LiveArm(
        "PSM1", lambda rig: tracker, outputs, lines.append, inputs.now, draw=lambda rig: lambda image, result: image
    )
    loop = LiveLoop([arm], inputs, lines.append, rig=Rig.of_camera(Camera(WIDTH, HEIGHT, 80.0, 80.0, 31.5, 22.0)))
    lines.clear()
    assert connection.open(60)
    stop = threading.Event()
    thread = threading.Thread(target=loop.run, args=(stop,), daemon=True)
    thread.start()
    wait_for(lambda: len(server.subscribed) == 4)
    yield Live(server, tracker, lines, connection, inputs, loop)
    stop.set()
    thread.join(60)
    connection.close()
    server.stop()
    assert not thread.is_alive()


def stamp(time: int, ros1: bool = False) -> dict[str, Any]:
    seconds, rest = divmod(time, SECOND)
    return {
        "stamp": {"secs": seconds, "nsecs": rest} if ros1 else {"sec": seconds, "nanosec": rest},
        "frame_id": "left",
    }


def image(time: int, number: int = 0, ros1: bool = False) -> dict[str, Any]:
    data = cv2.imencode(".png", pixels(number))[1].tobytes()
    return {"header": stamp(time, ros1), "format": "png", "data": base64.b64encode(data).decode()}


def joints(time: int, ros1: bool = False) -> dict[str, Any]:
    return {"header": stamp(time, ros1), "name": list(ARM), "position": sweep(time), "velocity": [], "effort": []}


def jaw(time: int) -> dict[str, Any]:
    return {"header": stamp(time), "name": ["jaw"], "position": [0.5], "velocity": [], "effort": []}


def follow(live: Live, time: int, number: int = 0, ros1: bool = False) -> None:
    """Send readings and an image, and wait until it has been followed."""
    live.server.send(JOINTS, joints(time, ros1))
    live.server.send(JAW, jaw(time))
    before = len(live.tracker.steps)
    live.server.send(IMAGE, image(time, number, ros1))
    wait_for(lambda: len(live.tracker.steps) > before)


def test_topics_are_subscribed_and_advertised_with_types(live: Live) -> None:
    wait_for(lambda: len(live.server.advertised) == 5)
    assert {topic: one["type"] for topic, one in live.server.subscribed.items()} == {
        IMAGE: "sensor_msgs/CompressedImage",
        CAMERA: "sensor_msgs/CameraInfo",
        JOINTS: "sensor_msgs/JointState",
        JAW: "sensor_msgs/JointState",
    }
    assert live.server.subscribed[IMAGE]["queue_length"] == 1
    assert live.server.advertised == {
        f"{FOUND}/camera_from_root": "geometry_msgs/msg/PoseStamped",
        f"{FOUND}/measured_js": "sensor_msgs/msg/JointState",
        f"{FOUND}/overlay/compressed": "sensor_msgs/msg/CompressedImage",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    }


def test_tracker_gets_image_and_readings(live: Live) -> None:
    follow(live, BEGIN, number=3)
    ((time, mask, seen),) = live.tracker.steps
    assert time == pytest.approx(BEGIN / SECOND, abs=1e-6)
    assert np.array_equal(seen["left"], pixels(3))
    assert mask is None  # there is no topic of masks
    arm, own = (dict(found) for _, found in live.tracker.readings)
    assert arm == pytest.approx(dict(zip(ARM, sweep(BEGIN), strict=True)))
    assert own == {"jaw": 0.5}


@pytest.mark.parametrize("ros1", [False, True])
def test_pose_joints_and_overlay_are_published_at_time_of_image(live: Live, ros1: bool) -> None:
    follow(live, BEGIN, number=4, ros1=ros1)
    wait_for(lambda: live.received(f"{FOUND}/overlay/compressed"))
    seconds, rest = ("secs", "nsecs") if ros1 else ("sec", "nanosec")
    expected = {seconds: BEGIN // SECOND, rest: BEGIN % SECOND}
    (pose,) = live.received(f"{FOUND}/camera_from_root")
    assert pose["header"] == {"stamp": expected, "frame_id": "camera"}
    orientation = [pose["pose"]["orientation"][axis] for axis in "xyzw"]
    np.testing.assert_allclose(Rotation.from_quat(orientation).as_matrix(), POSE[:3, :3], atol=1e-9)
    np.testing.assert_allclose([pose["pose"]["position"][axis] for axis in "xyz"], POSE[:3, 3], atol=1e-9)
    ((transform,),) = (one["transforms"] for one in live.received("/tf"))
    assert (transform["header"]["stamp"], transform["child_frame_id"]) == (expected, "PSM1_roll_link")
    (found,) = live.received(f"{FOUND}/measured_js")
    assert dict(zip(found["name"], found["position"], strict=True)) == pytest.approx(
        {"wrist_pitch": sweep(BEGIN)[4], "jaw": 0.5}
    )
    (overlay,) = live.received(f"{FOUND}/overlay/compressed")
    drawn = cv2.imdecode(np.frombuffer(base64.b64decode(overlay["data"]), np.uint8), cv2.IMREAD_COLOR)
    assert drawn.shape == (HEIGHT, WIDTH, 3)
    assert live.server.refused == []


def test_lost_instrument_has_status_and_no_pose(live: Live) -> None:
    live.tracker.lost = True
    follow(live, BEGIN)
    wait_for(lambda: live.received("/diagnostics"))
    ((status,),) = (one["status"] for one in live.received("/diagnostics"))
    assert (status["level"], status["name"], status["message"]) == (2, "dvrk_cmaes: PSM1", "lost")
    assert {"key": "reasons", "value": "no edge can be seen"} in status["values"]
    assert live.received(f"{FOUND}/camera_from_root") == []


def test_camera_is_received(live: Live) -> None:
    matrix = [80.25, 0, 31.5, 0, 81.75, 22.125, 0, 0, 1]
    live.server.send(
        CAMERA,
        {
            "header": stamp(BEGIN),
            "width": 64,
            "height": 48,
            "distortion_model": "plumb_bob",
            "d": [0.0] * 5,
            "k": matrix,
        },
    )
    rig = live.inputs.rigs.take(60)
    assert rig is not None
    assert rig.camera == Camera(64, 48, 80.25, 81.75, 31.5, 22.125, (0.0,) * 5)


def test_only_newest_image_is_followed(live: Live) -> None:
    """Images that arrive during a step are dropped, but for the last."""
    inside, go_on = threading.Event(), threading.Event()
    step = live.tracker.step

    def slow(*arguments: Any, **options: Any) -> Step:
        inside.set()
        assert go_on.wait(60)
        return step(*arguments, **options)

    live.tracker.step = slow  # type: ignore[method-assign]
    live.server.send(IMAGE, image(BEGIN))
    assert inside.wait(60)
    for k in range(1, 6):
        live.server.send(IMAGE, image(BEGIN + k * SECOND))
        live.server.send(JOINTS, joints(BEGIN + k * SECOND))
    live.server.send_text('{"op": "status", "level": "error", "msg": "the last message"}')
    wait_for(lambda: any("the last message" in line for line in live.lines))
    go_on.set()
    wait_for(lambda: len(live.tracker.steps) == 2)
    assert [round(time - BEGIN / SECOND) for time, _, _ in live.tracker.steps] == [0, 5]
    assert len(live.tracker.readings) == 5


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("no json", "a message that cannot be read: "),
        ('{"topic": "/left"}', "a message that cannot be read: "),
        ('{"op": "sing"}', "a message that cannot be read: expected the operation publish or status, got 'sing'"),
        ('{"op": "status", "level": "error", "msg": "no such type"}', ": no such type"),
    ],
)
def test_message_outside_protocol_is_reported_in_one_line(live: Live, text: str, line: str) -> None:
    before = len(live.lines)
    live.server.send_text(text)
    wait_for(lambda: len(live.lines) > before)
    (said,) = live.lines[before:]
    assert said.startswith(f"rosbridge 127.0.0.1:{live.server.port}")
    assert line in said
    assert "\n" not in said
    follow(live, BEGIN)


@pytest.mark.parametrize(
    ("topic", "fields", "line"),
    [
        (JOINTS, {}, f"{JOINTS}: header: expected an object, got nothing"),
        (JOINTS, {"header": stamp(1), "name": ["jaw"], "position": ["x"]}, f"{JOINTS}: position[0]: expected a finite"),
        (JOINTS, {"header": stamp(1), "name": ["jaw"], "position": [90]}, f"{JOINTS}: jaw: expected radians"),
        (
            JOINTS,
            {"header": stamp(1), "name": ["jaw"], "position": [0.1, 0.2]},
            f"{JOINTS}: position: expected 1 numbers, one for each name, got 2",
        ),
        (
            JOINTS,
            {"header": {"stamp": {}}, "name": ["jaw"], "position": [0.1]},
            f"{JOINTS}: header.stamp: expected sec",
        ),
        (IMAGE, {"header": stamp(1), "data": "???"}, f"{IMAGE}: data: expected bytes in base64, got '???'"),
        (IMAGE, {"header": stamp(1), "data": "AAAA"}, f"{IMAGE}: expected a PNG or JPEG, got something else"),
        (IMAGE, {"data": "AAAA"}, f"{IMAGE}: header: expected an object, got nothing"),
        (
            IMAGE,
            {"header": stamp(1), "width": 9, "height": 9, "step": 27, "encoding": "bgr8", "data": "AAAA"},
            f"{IMAGE}: expected 9 x 9 pixels of bgr8, got 3 bytes in rows of 27",
        ),
        (CAMERA, {"width": 64}, f"{CAMERA}: "),
    ],
)
def test_wrong_message_is_reported_in_one_line_and_loop_goes_on(
    live: Live, topic: str, fields: dict[str, Any], line: str
) -> None:
    before = len(live.lines)
    live.server.send(topic, fields)
    wait_for(lambda: len(live.lines) > before)
    (said,) = live.lines[before:]
    assert said.startswith(line)
    follow(live, BEGIN)


def test_image_out_of_order_is_reported(live: Live) -> None:
    follow(live, BEGIN)
    live.server.send(IMAGE, image(BEGIN - SECOND))
    wait_for(lambda: live.loop.counts.refused == 1)
    follow(live, BEGIN + SECOND)
    assert f"{IMAGE}: header.stamp: images that are -1.0 s from the last one are left out" in live.lines
    assert live.loop.counts.refused == 1


def test_topic_that_stops_is_reported_once_and_when_it_is_back(live: Live) -> None:
    follow(live, BEGIN)
    wait_for(lambda: any(line.startswith(f"{JAW}: no message for ") for line in live.lines))
    silent = next(line for line in live.lines if line.startswith(f"{JAW}: no message"))
    assert float(silent.removeprefix(f"{JAW}: no message for ").removesuffix(" s")) >= 0.5
    live.server.send(IMAGE, image(BEGIN + SECOND))
    wait_for(lambda: len(live.received("/diagnostics")) == 2)
    status = live.received("/diagnostics")[1]["status"][0]
    assert status["level"] == 1
    assert any(one["key"] == "silent_topics" and JAW in one["value"] for one in status["values"])
    live.server.send(JAW, jaw(BEGIN + SECOND))
    wait_for(lambda: f"{JAW}: messages again" in live.lines)
    assert sum(line.startswith(f"{JAW}: no message") for line in live.lines) == 1


def test_server_that_comes_back_is_found_again(live: Live) -> None:
    follow(live, BEGIN)
    name = f"rosbridge 127.0.0.1:{live.server.port}"
    live.server.stop()
    wait_for(lambda: f"{name}: connection lost; trying again" in live.lines)
    assert not live.connection.publish("/tf", {})
    live.server.received.clear()
    live.server.start()
    wait_for(lambda: len(live.server.subscribed) == 4)
    follow(live, BEGIN + SECOND)
    wait_for(lambda: live.received(f"{FOUND}/camera_from_root"))
    assert [line for line in live.lines if line.startswith(name)] == [
        f"{name}: connected",
        f"{name}: connection lost; trying again",
        f"{name}: connected",
    ]
    assert live.server.refused == []


def test_server_that_starts_late_is_found() -> None:
    server, lines = RosbridgeServer(), list[str]()
    server.start()
    server.stop()  # a port that is free
    connection = RosbridgeConnection("127.0.0.1", server.port, lines.append)
    assert not connection.open(0.2)
    assert lines == [f"rosbridge 127.0.0.1:{server.port}: no connection yet; trying again"]
    server.start()
    wait_for(lambda: len(lines) == 2)
    assert lines[1].endswith(": connected")
    connection.close()
    server.stop()


def test_connection_that_opens_before_its_events_are_awaited_is_used(
    live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = roslibpy.Ros

    def connected(host: str, port: int) -> roslibpy.Ros:
        ros = plain(host, port)
        wait_for(lambda: ros.factory._proto)
        return ros

    monkeypatch.setattr(roslibpy, "Ros", connected)  # the fixture's connection has started the thread of connections
    second = RosbridgeConnection("127.0.0.1", live.server.port, live.lines.append)
    before = len(live.lines)
    assert second.open(60)
    assert live.lines[before:] == [f"rosbridge 127.0.0.1:{live.server.port}: connected"]
    second.close()


def mask(time: int, number: int) -> dict[str, Any]:
    """Give a mask as a segmenter publishes it, an Image of mono8."""
    seen = np.where(pixels(number)[:, :, 1] > 127, 255, 0).astype(np.uint8)
    data = base64.b64encode(seen.tobytes()).decode()
    size = {"width": WIDTH, "height": HEIGHT, "step": WIDTH, "encoding": "mono8"}
    return {"header": stamp(time), **size, "data": data}


def test_masks_of_topic_are_followed_with_their_images() -> None:
    topics = InputTopics({"left": EyeTopics.of(IMAGE, CAMERA, {"PSM1": "/left/mask"})}, {"PSM1": (JOINTS,)})
    lines: list[str] = []
    inputs = Inputs(topics, lines.append)
    for k in range(12):
        inputs._on_part("left", IMAGE, image(BEGIN + k, k))
    assert inputs.frames.take(0.0) is None
    for k, kept in ((3, False), (5, True), (11, True)):  # the last eight images are kept
        inputs._on_part("left", "/left/mask", mask(BEGIN + k, k))
        frame = inputs.frames.take(1.0)
        assert frame is not None
        assert frame.time == BEGIN + k
        arrays = frame.decoded()
        assert ("left" in arrays.images) == kept
        assert np.array_equal(arrays.masks["PSM1"]["left"], pixels(k)[:, :, 1] > 127)
    assert lines == []


def test_readings_that_nobody_takes_do_not_pile_up() -> None:
    inputs = Inputs(TOPICS, list[str]().append)
    for k in range(3000):
        inputs._on_joints(JOINTS, inputs.readings["PSM1"], joints(BEGIN + k))
    taken = inputs.readings["PSM1"].take_all()
    assert [taken[0].time, taken[-1].time, len(taken)] == [BEGIN + 2000, BEGIN + 2999, 1000]
