"""`dvrk-cmaes live` on the bundled session, over a websocket of 127.0.0.1."""

from __future__ import annotations

import sys
from io import StringIO

import pytest
from helpers.commands import run_command
from helpers.fake_rclpy import Bus

from dvrk_cmaes.cli import live as cli_live
from dvrk_cmaes.cli.terminal import note


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
