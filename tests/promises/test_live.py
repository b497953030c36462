"""`live` over the wire: a server of rosbridge's protocol plays a recording, and what comes back is compared with truth.

The recording is played three times more slowly than it was taken, and the next image waits until something is published
about the one before.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from examples.play_session import BEGIN, Robot, RosbridgeServer, header
from scipy.spatial.transform import Rotation

from promises.program import PROGRAM, Kept, run
from promises.test_recordings import ONE, PAIR, PLAIN
from promises.truth import distance, matrix, median, truth

pytestmark = pytest.mark.usefixtures("searches_short")

FRAMES = 12
MASKS = "/left/PSM1/mask/compressed"


class Live:
    """`live` in a process of its own, with the server that it is connected to and the robot whose frames that sends."""

    def __init__(self, session: Path, *options: object) -> None:
        self.server, self.robot = RosbridgeServer(), Robot(session)
        self.server.start()
        words = [PROGRAM, "live", "--port", self.server.port, "--wait", *self.robot.options.split(), *options]
        self.process = subprocess.Popen([*map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.code, self.out, self.err, self.drawn = 0, "", "", "--overlay" in options

    def __enter__(self) -> Live:
        until(lambda: {*self.robot.evidence, *self.robot.joints.values()} <= self.server.subscribed.keys())
        return self

    def __exit__(self, *error: object) -> None:
        """End it by Ctrl-C, and keep what it printed."""
        self.process.send_signal(signal.SIGINT)
        self.out, self.err = self.process.communicate(timeout=60)
        self.code = self.process.returncode
        self.server.stop()

    def readings(self, arm: str, seconds: float, values: Mapping[str, float], kind: str = "", **more: object) -> None:
        """Send readings as an arm publishes them."""
        fields = {"header": header(seconds), "name": list(values), "position": list(values.values())}
        self.server.send(f"/{arm}{kind}/measured_js", fields | more)

    def send(self, number: int, seconds: float) -> None:
        """Send what a frame has."""
        for arm, session in self.robot.arms.items():
            values = dict(session.frames[number].readings)
            jaw = {"jaw": values.pop("jaw")}
            self.readings(arm, seconds, values)
            self.readings(arm, seconds, jaw, "/jaw")
        for topic, info in self.robot.cameras().items():
            self.server.send(topic, info)
        for topic, data in self.robot.pictures(number):
            for name in ("/left/image/compressed", topic) if self.drawn else (topic,):  # its images are its masks
                self.server.send(name, {"header": header(seconds), "format": "png", "data": data})

    def states(self, arm: str) -> list[dict[str, Any]]:
        """Give the published states of an arm, in order."""
        found = [status for _, message in self.server.received.get("/diagnostics", []) for status in message["status"]]
        return [status for status in found if status["name"] == f"dvrk_cmaes: {arm}"]

    def poses(self, arm: str) -> dict[int, np.ndarray]:
        """Give the published poses of an arm by the time of their images, ms."""
        found = {}
        for _, message in self.server.received.get(f"/dvrk_cmaes/{arm}/camera_from_root", []):
            stamp, pose = message["header"]["stamp"], message["pose"]["pose"]
            out = np.eye(4)
            out[:3, :3] = Rotation.from_quat([pose["orientation"][axis] for axis in "xyzw"]).as_matrix()
            out[:3, 3] = [pose["position"][axis] for axis in "xyz"]
            found[round((stamp["sec"] - BEGIN) * 1e3 + stamp["nanosec"] / 1e6)] = out
        return found

    def said(self, counts: Mapping[str, int]) -> bool:
        """Whether at least these numbers of states were published about the arms."""
        return all(len(self.states(arm)) >= count for arm, count in counts.items())

    def step(self, number: int, seconds: float) -> None:
        """Send a frame, and wait for a state of each arm."""
        goals = {arm: len(self.states(arm)) + 1 for arm in self.robot.arms}
        self.send(number, seconds)
        until(partial(self.said, goals), 30)

    def play(self, frames: int) -> None:
        """Send what each frame has, ten a second."""
        begin = time.monotonic()
        for k in range(frames):
            time.sleep(max(0.0, begin + k / 10 - time.monotonic()))
            self.step(k, k / 10)


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait for a condition."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def errors_of(found: Mapping[int, np.ndarray], true: Mapping[str, Any]) -> list[float]:
    """Give the distances of published roots from the true ones of their frames, mm."""
    return [distance(pose, matrix(true[f"{time // 100:04d}"], "T_camera_roll_link"))[0] for time, pose in found.items()]


@pytest.fixture(scope="module", autouse=True)
def silent() -> Iterator[subprocess.Popen[str]]:
    """`live` with a server that sends nothing, for which it waits while the other tests of this file run."""
    server = RosbridgeServer()
    server.topics = {"/left/image_raw": "sensor_msgs/Image"}
    server.start()
    words = [PROGRAM, "live", "--port", str(server.port), "--image-topic", "/left/image_raw"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()
    server.stop()


def test_one_arm_is_followed_and_published(kept: Kept) -> None:
    session = kept.synth(*ONE)
    calibration = kept("track", session).folder / "session.json"
    with Live(session, "--session", calibration, "--lag", 0.2, "--overlay") as live:
        server = live.server
        live.play(25)
        found, true = live.poses("PSM1"), truth(session)
        assert server.refused == []
        assert {topic.rpartition("/")[2] for topic in server.advertised} >= {"camera_from_root", "tf", "diagnostics"}
        joints = [message for _, message in server.received["/dvrk_cmaes/PSM1/measured_js"]]
        assert set(joints[-1]["name"]) >= {"wrist_pitch", "wrist_yaw", "jaw"}
        children = {t["child_frame_id"] for _, m in server.received["/tf"] for t in m["transforms"]}
        assert "PSM1_roll_link" in children
        _, overlay = server.received["/dvrk_cmaes/PSM1/overlay/compressed"][-1]
        assert overlay["format"].endswith("jpeg")
    errors = errors_of(found, true)
    assert len(errors) > 15
    assert median(errors) < 1.5
    assert re.search(r"[1-9]\d* ok \(from \d+\.\d s on\); .*; age of the last images \d+ ms in the median", live.out)


def test_nothing_is_ok_before_the_base_is_known_and_faults_cost_one_image_each(kept: Kept, tmp_path: Path) -> None:
    session = kept.synth(*ONE)
    with Live(session, "--camera", session / "camera.yaml", "--out", tmp_path / "live") as live:
        server, yaw = live.server, {"yaw": 0.1}
        live.play(3)
        server.send_text("this is no message")
        server.send(MASKS, {"header": 3})
        server.send(MASKS, {"header": header(0.35), "format": "png", "data": "AAAA"})
        live.readings("PSM1", 0.35, yaw, effort=[0.123456] * 200_000)
        live.readings("PSM1", 9000.0, yaw)
        live.send(3, 3600.0)  # an image of another time
        for k in range(4, 9):
            live.step(k, k / 10)
        assert live.process.poll() is None  # no message ends it
        for k in range(9, 14):  # the clock was set
            live.send(k, 7200.0 + k / 10)
            time.sleep(0.05)
        until(lambda: bool(server.received["/diagnostics"][-1][1]["header"]["stamp"]["sec"] > BEGIN + 7000))
        found = live.states("PSM1")
    assert all(state["level"] > 0 and state["message"] for state in found)
    assert live.code == 0
    assert live.out.count("\n") == 1
    assert re.search(
        "results published, 0 ok; .*; (base not known yet|searching): .*; age of the last images", live.out
    )
    lines = live.err.splitlines()
    assert lines[-1].endswith("live: session.json of 1 of 1 arms not written: keyframes have not determined a base")
    assert all(line.startswith("dvrk-cmaes: ") for line in lines), live.err
    for expected in ("connected", "+3599", "at most 1 MB", "readings +8999", MASKS, "begins anew"):
        assert any(expected in line for line in lines), (expected, lines)


def test_two_arms_are_followed_by_both_eyes(kept: Kept) -> None:
    session = kept.synth(*PAIR)
    tracked = kept("track", session, *PLAIN).folder
    with Live(session, "--rectified", "--session", tracked) as live:
        live.play(FRAMES)
        seen = {arm: live.poses(arm) for arm in live.robot.arms}
        for arm, found in seen.items():
            errors = errors_of(found, truth(session, arm))
            assert len(errors) >= 5  # where time is short, the arms take turns
            assert median(errors) < 1.5
        for child in psutil.Process(live.process.pid).children(recursive=True):
            if "resource_tracker" not in " ".join(child.cmdline()):
                child.kill()  # those that follow an arm each, and their own
        for k in range(FRAMES, 10 * FRAMES):
            live.step(k % FRAMES, k / 10)
            if all(max(live.poses(arm)) > max(seen[arm]) for arm in seen):
                break  # followed again
        else:
            pytest.fail("not followed again")
    assert "the process of this arm died" in live.err


def test_silent_server_is_one_line_and_exit_code_1(silent: subprocess.Popen[str]) -> None:
    out, err = silent.communicate(timeout=60)
    assert (silent.returncode, out) == (1, "")
    assert "/left/image_raw" in err


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), "--image-topic: expected"),
        (("--image-topic", "/i", "--psm", "PSM1", "PSM2"), "--mask-topic: expected a topic for each"),
        (("--image-topic", "/i", "--right-mask-topic", "/m"), "--right-image-topic: expected"),
    ],
)
def test_topics_that_do_not_go_together_are_refused_before_a_library_that_is_not_there(
    words: tuple[str, ...], expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "roslibpy", None)
    assert run("live", *words).refusal.startswith(expected)
