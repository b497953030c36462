"""`dvrk-cmaes live` on the bundled session, over a websocket of 127.0.0.1."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from functools import partial
from io import StringIO
from typing import Any

import pytest
import yaml
from examples.play_session import RosbridgeServer
from helpers.commands import run_command
from helpers.fake_rclpy import Bus
from helpers.made_recordings import BEGIN, SECOND
from helpers.places import bundled_path

from dvrk_cmaes import DvrkCmaesError, prepare
from dvrk_cmaes.cli import live as cli_live
from dvrk_cmaes.cli.terminal import note
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.live.follow import ArmSetup, LiveSetup, follow
from dvrk_cmaes.live.inputs import EyeTopics, InputTopics
from dvrk_cmaes.live.rosbridge import RosbridgeConnection

BODY = prepare("lnd")
DEMO = bundled_path("demo")
READINGS = {"PSM1": ("/PSM1/measured_js",)}


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


@pytest.fixture
def server() -> Iterator[RosbridgeServer]:
    server = RosbridgeServer()
    server.start()
    yield server
    server.stop()


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
