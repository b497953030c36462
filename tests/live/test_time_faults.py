"""Faults of messages and of their times: each costs at most a few images and one line, and the loop goes on."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from examples.play_session import RosbridgeServer
from helpers.live_wires import BEGIN, SECOND, Found, Steps, Wire, stamp
from helpers.waiting import wait_for

from dvrk_cmaes import Camera, Rig
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.live import arm as live_arm
from dvrk_cmaes.live import loop as live_loop
from dvrk_cmaes.live.arm import LiveArm
from dvrk_cmaes.live.connection import LogThrottle
from dvrk_cmaes.live.inputs import EyeTopics, Inputs, InputTopics
from dvrk_cmaes.live.loop import LiveLoop
from dvrk_cmaes.live.outputs import Outputs
from dvrk_cmaes.live.rosbridge import RosbridgeConnection
from dvrk_cmaes.live.stamps import ImageTimes

IMAGE, JOINTS = "/left/image", "/PSM1/measured_js"
TOPICS = InputTopics({"left": EyeTopics.of(IMAGE)}, {"PSM1": (JOINTS,)})


@dataclass
class Follower(Steps):
    """A tracker that keeps the times it was given, and raises the errors it was given."""

    errors: list[Exception]
    times: list[float] = field(default_factory=list)

    def step(self, readings: Any, time: float, mask: Any = None, image: Any = None, ignore: Any = None) -> Found:
        assert not self.times or time > self.times[-1]
        if self.errors:
            raise self.errors.pop()
        self.times.append(time)
        return Found()


@dataclass
class Live:
    """A loop on another thread, whose trackers share the errors that are still to be raised."""

    wire: Wire
    lines: list[str]
    trackers: list[Follower]
    errors: list[Exception]
    loop: LiveLoop

    def image(self, time: float) -> bool:
        """Send an image at a time, s, and wait until it was judged; returns whether it was followed."""
        counts = self.loop.counts
        before = counts.followed, counts.refused
        self.wire.receivers[IMAGE](
            {"header": stamp(time), "width": 4, "height": 2, "step": 4, "encoding": "mono8", "data": "AAAAAAAAAAA="}
        )
        wait_for(lambda: (counts.followed, counts.refused) != before)
        return counts.followed > before[0]

    def joints(self, time: float) -> None:
        """Send readings at a time, s."""
        self.wire.receivers[JOINTS]({"header": stamp(time), "name": ["jaw"], "position": [0.5]})


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch) -> Iterator[Live]:
    for module in (live_arm, live_loop):
        monkeypatch.setattr(module, "OLD", np.inf)  # the images' clock does not go with that of the computer
    wire, lines, trackers, errors = Wire(), list[str](), list[Follower](), list[Exception]()

    def make_tracker(rig: Rig) -> Follower:
        trackers.append(Follower(errors))
        return trackers[-1]

    say = LogThrottle(lines.append)
    inputs = Inputs(TOPICS, say, longest_silence=1e6)
    inputs.subscribe(wire)
    outputs = Outputs(wire, FrameNames())
    arm = LiveArm("PSM1", make_tracker, outputs, say, lambda: 10 * inputs.now())  # states come ten times as often
    loop = LiveLoop([arm], inputs, say, rig=Rig.of_camera(Camera(4, 2, 4.0, 4.0, 2.0, 1.0)))
    lines.clear()
    stop = threading.Event()
    thread = threading.Thread(target=loop.run, args=(stop,), kwargs={"wait": 0.02}, daemon=True)
    thread.start()
    yield Live(wire, lines, trackers, errors, loop)
    stop.set()
    thread.join(60)
    assert not thread.is_alive()


def test_time_that_stands_still_is_named_once_and_in_the_status(live: Live) -> None:
    assert live.image(1.0)
    assert not any(live.image(1.0) for _ in range(20))
    line = f"{IMAGE}: header.stamp: images that are at the time of the last one are left out"
    assert live.lines == [line]
    before = len(live.wire.states)
    wait_for(lambda: len(live.wire.states) > before)
    state = live.wire.states[-1]
    assert (state["level"], state["message"]) == (2, "image left out")
    assert state["values"][0] == {"key": "reasons", "value": line}
    assert live.image(1.1)
    assert live.wire.states[-1]["message"] == "ok"


def test_three_steps_in_a_row_that_fail_begin_following_anew(live: Live) -> None:
    live.errors += [MemoryError()] * 3
    assert [live.image(k / 10) for k in range(5)] == [False] * 3 + [True] * 2
    assert live.lines == ["out of memory; the image is left out; after 3 in a row following begins anew"]
    assert len(live.trackers) == 2


def test_status_says_what_is_waited_for_while_nothing_comes(live: Live) -> None:
    wait_for(lambda: len(live.wire.states) > 2)
    assert {state["message"] for state in live.wire.states} == {"waiting for images"}
    assert live.image(0.0)
    assert live.wire.states[-1]["message"] == "ok"
    before = len(live.wire.states)
    wait_for(lambda: len(live.wire.states) > before)
    assert live.wire.states[-1]["message"] == "waiting for images"


def test_images_late_by_the_network_are_left_out_without_a_restart() -> None:
    times = ImageTimes()
    used = []
    for k in (0, 1, 2, 4, 3, 5, 6, 8, 7, 9):
        judged = times.judge(BEGIN + k * SECOND // 30)
        used.append(judged.used)
        assert not judged.restarts
        if judged.used:
            times.follow(BEGIN + k * SECOND // 30)
    assert used == [True] * 4 + [False] + [True] * 3 + [False] + [True]


@pytest.fixture
def connected() -> Iterator[tuple[RosbridgeServer, RosbridgeConnection, list[str]]]:
    server, lines = RosbridgeServer(), list[str]()
    server.start()
    connection = RosbridgeConnection("127.0.0.1", server.port, lines.append)
    assert connection.open(60)
    yield server, connection, lines
    connection.close()
    server.stop()


def test_messages_that_a_slow_server_does_not_take_are_dropped(
    connected: tuple[RosbridgeServer, RosbridgeConnection, list[str]],
) -> None:
    server, connection, _ = connected
    connection.advertise("/tf", "std_msgs/String")
    wait_for(lambda: len(server.advertised) == 1)
    connection._flow.pauseProducing()
    for k in range(100):
        assert not connection.publish("/tf", {"data": str(k)})
    connection._flow.resumeProducing()
    assert connection.publish("/tf", {"data": "later"})
    wait_for(lambda: len(server.received.get("/tf", [])) == 1)
    assert [message["data"] for _, message in server.received["/tf"]] == ["later"]
