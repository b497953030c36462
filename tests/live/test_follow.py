"""`dvrk-cmaes live` on the bundled session, over a websocket of 127.0.0.1."""

from __future__ import annotations

import sys
from io import StringIO
from typing import Any

import pytest
import yaml
from helpers.commands import run_command
from helpers.fake_rclpy import Bus
from helpers.made_recordings import BEGIN, SECOND
from helpers.places import bundled_path

from dvrk_cmaes.cli import live as cli_live
from dvrk_cmaes.cli.terminal import note

DEMO = bundled_path("demo")


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
