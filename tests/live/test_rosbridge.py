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
from helpers.live_wires import Steps
from helpers.made_recordings import ARM, BEGIN, HEIGHT, SECOND, WIDTH, pixels, sweep
from helpers.transforms import moved
from helpers.waiting import wait_for

from dvrk_cmaes import Camera, InputError, Rig
from dvrk_cmaes.export.frames import FrameNames
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

    def covariance_in_camera(self) -> np.ndarray:
        return np.eye(8)


@dataclass
class Recorder(Steps):
    """A tracker that gives the last readings as joints, and keeps what it was given."""

    readings: list[tuple[float, Mapping[str, float]]] = field(default_factory=list)
    steps: list[tuple[float, Any, Any]] = field(default_factory=list)
    lost: bool = False

    def step(self, readings: Any, time: float, mask: Any = None, image: Any = None, ignore: Any = None) -> Step:
        self.readings += readings
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
    arm = LiveArm("PSM1", lambda rig: tracker, outputs, lines.append, inputs.now)
    arm.draws = True  # images are decoded in colours
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
    assert [round(time) for time, _, _ in live.tracker.steps] == [0, 5]
    assert len(live.tracker.readings) == 5


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
