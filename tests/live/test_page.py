"""The page on `live`: each command runs as printed, with a server that sends what it reads; so do its examples."""

from __future__ import annotations

import base64
import re
import runpy
import signal
import sys
import threading
import time
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from examples.play_session import Robot as Player
from examples.play_session import RosbridgeServer
from examples.play_session import main as play
from helpers.fake_rclpy import Bus, get_message
from helpers.live_wires import info, stamp
from helpers.moving_worlds import SMALL
from helpers.places import ROOT, bundled_path
from helpers.printed_blocks import PROGRAM, blocks, run
from helpers.waiting import wait_for

from dvrk_cmaes import prepare, read_session
from dvrk_cmaes.cli import live as cli_live
from dvrk_cmaes.cli.app import app
from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.segmentation import Hints
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.recording import write_recording
from dvrk_cmaes.synth.session import SessionPlan

PAGE = list(blocks((ROOT / "data" / "reference" / "live.md").read_text(encoding="utf-8")))
COMMANDS = [command for block in PAGE for command in block.commands]
SHOWN = [block.text.splitlines() for block in PAGE if block.text.startswith("dvrk-cmaes: ")]
EXAMPLES = ROOT / "scripts" / "examples"
DEMO = read_session(bundled_path("demo"))


class Robot:
    """Sends a frame of the demo on all topics that are read, and Ctrl-C once each arm has a status of an image."""

    def __init__(self, server: RosbridgeServer, arms: int) -> None:
        self._server, self._arms = server, arms
        files = DEMO.frames[1]
        self._readings = {"name": list(files.readings), "position": list(files.readings.values())}
        self._image, self._mask = cv2.imread(str(files.image)), cv2.imread(str(files.mask), cv2.IMREAD_GRAYSCALE)

    def fields(self, topic: str, kind: str, time: float) -> dict[str, Any]:
        """Give a message of a topic."""
        if kind == "sensor_msgs/JointState":
            return {"header": stamp(time), **self._readings}
        if kind == "sensor_msgs/CameraInfo":
            return info(DEMO.camera, baseline=0.005 if "right" in topic else 0.0)
        pixels = self._mask if "mask" in topic else self._image
        if kind == "sensor_msgs/CompressedImage":
            return {"header": stamp(time), "format": "png", "data": encoded(cv2.imencode(".png", pixels)[1].tobytes())}
        height, width = pixels.shape
        size = {"width": width, "height": height, "step": width, "encoding": "mono8"}
        return {"header": stamp(time), **size, "data": encoded(pixels.tobytes())}

    def run(self) -> None:
        for now in 0.2 * np.arange(600):
            for topic, one in sorted(self._server.subscribed.items(), key=lambda item: "mask" in item[0]):
                self._server.send(topic, self.fields(topic, one["type"], now))
            time.sleep(0.2)
            statuses = [fields["status"][0] for _, fields in self._server.received.get("/diagnostics", [])]
            seen = {one["hardware_id"] for one in statuses if any(v["key"] == "age_ms" for v in one["values"])}
            if len(seen) == self._arms:
                signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)  # Ctrl-C
                return


def encoded(data: bytes) -> str:
    return base64.b64encode(data).decode()


@pytest.mark.parametrize("command", [command for command in COMMANDS if " live " in command])
def test_command_follows_what_a_server_sends(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    server = RosbridgeServer()
    monkeypatch.setattr(cli_live, "shown_state", partial(cli_live.shown_state, lines=0.1))
    server.start()
    robot = threading.Thread(target=Robot(server, 2 if "PSM2" in command else 1).run, daemon=True)
    robot.start()
    ran = run(f"{command.replace('--host robot', '')} --port {server.port}")
    robot.join(60)
    server.stop()
    assert ran.code == 0, ran.err
    followed, published = map(int, re.findall(r"(\d+) (?:images followed|results published)", ran.out))
    assert published >= followed > 0
    if "PSM2" not in command:
        (shown,) = SHOWN
        for line in shown:
            words = re.sub(r"\d+(?:\.\d+)?", "#", line).replace("base +- # mm", "base not known yet")
            pattern = re.sub("(image|keyframe)s", r"\1s?", re.escape(words.replace("robot:#", "#:#")))
            pattern = pattern.replace(r"\#", r"[\d.]+")
            assert re.search(f"^{pattern}$", ran.err, re.MULTILINE), (pattern, ran.err)


def test_recording_that_is_played_is_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "session", SessionPlan(prepare("lnd"), SMALL, LEVELS["clean"], "video", 90, 4, {}))
    robot = Player(tmp_path / "session")
    server = RosbridgeServer()
    monkeypatch.setattr("examples.play_session.RosbridgeServer", lambda port: server)
    main = threading.main_thread().ident

    def play_and_end() -> None:
        play(str(tmp_path / "session"), 0)
        signal.pthread_kill(main, signal.SIGINT)  # Ctrl-C

    playing = threading.Thread(target=play_and_end, daemon=True)
    playing.start()
    wait_for(lambda: server.port)
    ran = run(f"dvrk-cmaes live --port {server.port} {robot.options}")
    playing.join(60)
    followed = int(re.findall(r"(\d+) images followed", ran.out)[0])
    poses = [fields["pose"]["pose"] for _, fields in server.received["/dvrk_cmaes/PSM1/camera_from_root"]]
    assert 0 < len(poses) <= followed <= 90
    truths = [truth.camera_from_root[:3, 3] for truth in robot.session.truth.frames.values()]
    found = np.array([poses[-1]["position"][axis] for axis in "xyz"])
    assert min(np.linalg.norm(found - truth) for truth in truths) < 0.005  # m


def test_node_of_masks_publishes_one_for_each_image(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, boxes = Bus(), list[Any]()
    bus.install(monkeypatch)
    messages = ModuleType("sensor_msgs.msg")
    for name in ("CompressedImage", "Image"):
        setattr(messages, name, get_message(f"sensor_msgs/msg/{name}"))
    monkeypatch.setitem(sys.modules, "sensor_msgs", ModuleType("sensor_msgs"))
    monkeypatch.setitem(sys.modules, "sensor_msgs.msg", messages)

    class Sam2:
        def __init__(self, weights: str) -> None:
            assert weights == "sam2"

        def segment(self, image: np.ndarray, hints: Hints) -> Any:
            boxes.append(hints.box)
            return segment(image, box=hints.box)

    monkeypatch.setattr("dvrk_cmaes.segment.sam2.Sam2", Sam2)
    runpy.run_path(str(EXAMPLES / "sam2_mask_node.py"))["main"]("sam2", "350,10,639,440")
    files = DEMO.frames[1]
    message = get_message("sensor_msgs/msg/CompressedImage")()
    message.data, message.header.stamp.sec = Path(str(files.image)).read_bytes(), 7
    _, receive = bus.receivers["/left/image_rect_color/compressed"]
    for _ in range(2):
        receive(message)
    first, _ = bus.published["/left/mask"]
    assert (first.header.stamp.sec, first.encoding, first.step) == (7, "mono8", first.width)
    mask = np.frombuffer(first.data, np.uint8).reshape(first.height, first.width) > 127
    left, top, right, bottom = boxes[1]
    assert boxes[0] == (350.0, 10.0, 639.0, 440.0)
    assert mask[top : bottom + 1, left : right + 1].sum() == mask.sum() > 1000


def launched(monkeypatch: pytest.MonkeyPatch, **given: str) -> tuple[list[list[str]], dict[str, SimpleNamespace]]:
    """Give the commands and, by package, the nodes that the launch file starts with arguments."""
    launch = {"LaunchContext": object, "LaunchDescription": list}
    stated: dict[str, str] = {}
    actions = {
        "DeclareLaunchArgument": lambda name, default_value: stated.update({name: given.get(name, default_value)}),
        "ExecuteProcess": lambda cmd, output: cmd,
        "OpaqueFunction": lambda function: function,
    }
    substitutions = {"LaunchConfiguration": lambda name: SimpleNamespace(perform=lambda context: stated[name])}
    modules = {"launch": launch, "launch.actions": actions, "launch.substitutions": substitutions}
    for name, members in {**modules, "launch_ros": {}, "launch_ros.actions": {"Node": SimpleNamespace}}.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    *_, start = runpy.run_path(str(EXAMPLES / "live_launch.py"))["generate_launch_description"]()
    started = start(None)
    commands = [one for one in started if isinstance(one, list)]
    return commands, {one.package: one for one in started if not isinstance(one, list)}


def test_launch_file_starts_commands_that_are_valid(monkeypatch: pytest.MonkeyPatch) -> None:
    (live, masks), nodes = launched(monkeypatch, arm="PSM2", image_topic="/right/image")
    assert Path(masks[1]).is_file()
    assert PROGRAM.match(" ".join(live))
    assert {"/right/image", "PSM2"} <= {*live}
    app.parse_args(live[1:], exit_on_error=False, print_error=False)
    assert Path(nodes["rviz2"].arguments[1]).is_file()
    assert nodes["robot_state_publisher"].remappings == [("joint_states", "/dvrk_cmaes/PSM2/measured_js")]


def test_rviz_gets_the_links_by_their_names_in_tf_and_meshes_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    commands, nodes = launched(monkeypatch, live="false")
    assert commands == []
    robot = ET.fromstring(nodes["robot_state_publisher"].parameters[0]["robot_description"].encode())
    links = {link.attrib["name"] for link in robot.iter("link")}
    assert "PSM1_roll_link" in links
    assert {end.attrib["link"] for joint in robot.iter("joint") for end in joint if "link" in end.attrib} <= links
    assert all(Path(mesh.attrib["filename"].removeprefix("file://")).is_file() for mesh in robot.iter("mesh"))
    shown = yaml.safe_load((EXAMPLES / "instrument.rviz").read_text())["Visualization Manager"]
    topics = {display["Topic"]["Value"] for display in shown["Displays"] if "Topic" in display}
    assert topics == {"/dvrk_cmaes/PSM1/camera_from_root", "/dvrk_cmaes/PSM1/overlay/compressed"}
