"""`live` over the wire: a server of rosbridge's protocol plays a recording, and what comes back is compared with truth.

The recording is played three times more slowly than it was taken, and the next image waits until something is published
about the one before.
"""

from __future__ import annotations

import base64
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import pytest
import yaml
from examples.play_session import RosbridgeServer
from scipy.spatial.transform import Rotation

from dvrk_cmaes import Camera, read_camera, read_session
from promises.program import OUT, PROGRAM, Kept, distance, matrix, median, run, synth, truth
from promises.test_recordings import ONE, PAIR, PLAIN

pytestmark = pytest.mark.usefixtures("searches_short")

FRAMES = 12
START = 1_795_000_000
OUTER = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")


def header(seconds: float) -> dict[str, Any]:
    """Give a header with a time after START."""
    whole, rest = divmod(round(seconds * 1e9), 10**9)
    return {"stamp": {"sec": START + whole, "nanosec": rest}, "frame_id": "left"}


def mask_message(seconds: float, mask: np.ndarray) -> dict[str, Any]:
    """Give a mask as a segmenter publishes it, compressed."""
    data = cv2.imencode(".png", np.where(mask, 255, 0).astype(np.uint8))[1].tobytes()
    return {"header": header(seconds), "format": "png", "data": base64.b64encode(data).decode()}


def joints_message(seconds: float, names: tuple[str, ...], readings: Mapping[str, float]) -> dict[str, Any]:
    """Give readings as an arm publishes them."""
    position = [readings[name] for name in names]
    return {"header": header(seconds), "name": list(names), "position": position, "velocity": [], "effort": []}


def camera_message(camera: Camera, baseline: float = 0.0) -> dict[str, Any]:
    """Give the CameraInfo of an eye at a distance, m, from the left one."""
    return {
        "header": header(0.0),
        "width": camera.width,
        "height": camera.height,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": camera.matrix.ravel().tolist(),
        "r": np.eye(3).ravel().tolist(),
        "p": np.c_[camera.matrix, [-camera.fx * baseline, 0.0, 0.0]].ravel().tolist(),
    }


class Live:
    """`live` in a process of its own, with the server that it is connected to."""

    def __init__(self, *options: object) -> None:
        self.server = RosbridgeServer()
        self.server.start()
        words = [PROGRAM, "live", "--port", self.server.port, "--wait", *options]
        self.process = subprocess.Popen([*map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.code, self.out, self.err = 0, "", ""

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *error: object) -> None:
        """End it by Ctrl-C, and keep what it printed."""
        self.process.send_signal(signal.SIGINT)
        self.out, self.err = self.process.communicate(timeout=60)
        self.code = self.process.returncode
        self.server.stop()


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait for a condition."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def states(server: RosbridgeServer, arm: str) -> list[dict[str, Any]]:
    """Give the published states of an arm, in order."""
    found = [status for _, message in server.received.get("/diagnostics", []) for status in message["status"]]
    return [status for status in found if status["name"] == f"dvrk_cmaes: {arm}"]


def poses(server: RosbridgeServer, arm: str) -> dict[int, np.ndarray]:
    """Give the published poses of an arm by the time of their images, ms."""
    found = {}
    for _, message in server.received.get(f"/dvrk_cmaes/{arm}/camera_from_root", []):
        stamp, pose = message["header"]["stamp"], message["pose"]["pose"]
        out = np.eye(4)
        out[:3, :3] = Rotation.from_quat([pose["orientation"][axis] for axis in "xyzw"]).as_matrix()
        out[:3, 3] = [pose["position"][axis] for axis in "xyz"]
        found[round((stamp["sec"] - START) * 1e3 + stamp["nanosec"] / 1e6)] = out
    return found


def said(server: RosbridgeServer, counts: Mapping[str, int]) -> bool:
    """Whether at least these numbers of states were published about the arms."""
    return all(len(states(server, arm)) >= count for arm, count in counts.items())


def play(server: RosbridgeServer, frames: int, send: Callable[[int, float], None], arms: tuple[str, ...]) -> None:
    """Send what each frame has, ten a second."""
    begin = time.monotonic()
    for k in range(frames):
        time.sleep(max(0.0, begin + k / 10 - time.monotonic()))
        goals = {arm: len(states(server, arm)) + 1 for arm in arms}
        send(k, k / 10)
        until(partial(said, server, goals), 30)


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
    session = synth(kept, *ONE)
    calibration = kept("track", session, "--out", OUT).folder / "session.json"
    files = list(read_session(session).frames)
    camera = read_camera(session / "camera.yaml")
    topics = ("--image-topic", "/left/image_raw/compressed", "--mask-topic", "/left/mask/compressed")
    with Live(*topics, "--session", calibration, "--lag", 0.2, "--overlay") as live:
        server = live.server
        until(lambda: len(server.subscribed) >= 5)

        def send(k: int, seconds: float) -> None:
            server.send("/left/camera_info", camera_message(camera))
            readings = dict(files[k].readings)
            server.send("/PSM1/measured_js", joints_message(seconds, OUTER, readings))
            server.send("/PSM1/jaw/measured_js", joints_message(seconds, ("jaw",), readings))
            mask = cv2.imread(str(files[k].mask), cv2.IMREAD_GRAYSCALE) > 127
            server.send("/left/image_raw/compressed", mask_message(seconds, mask))
            server.send("/left/mask/compressed", mask_message(seconds, mask))

        play(server, 25, send, ("PSM1",))
        found, true = poses(server, "PSM1"), truth(session)
        assert server.refused == []
        assert {topic.rpartition("/")[2] for topic in server.advertised} >= {"camera_from_root", "tf", "diagnostics"}
        joints = [message for _, message in server.received["/dvrk_cmaes/PSM1/measured_js"]]
        assert set(joints[-1]["name"]) >= {"wrist_pitch", "wrist_yaw", "jaw"}
        children = {t["child_frame_id"] for _, m in server.received["/tf"] for t in m["transforms"]}
        assert "PSM1_roll_link" in children
        _, overlay = server.received["/dvrk_cmaes/PSM1/overlay/compressed"][-1]
        assert overlay["format"].endswith("jpeg")
    errors = [
        distance(pose, matrix(true[files[at // 100].name], "T_camera_roll_link"))[0] for at, pose in found.items()
    ]
    assert len(errors) > 15
    assert median(errors) < 1.5


def test_nothing_is_ok_before_the_base_is_known_and_faults_cost_one_image_each(kept: Kept, tmp_path: Path) -> None:
    session = synth(kept, *ONE)
    files = list(read_session(session).frames)
    topics = ("--image-topic", "/left/image_raw/compressed", "--mask-topic", "/left/mask/compressed")

    def send(k: int, seconds: float) -> None:
        readings = dict(files[k].readings)
        server.send("/PSM1/measured_js", joints_message(seconds, OUTER, readings))
        server.send("/PSM1/jaw/measured_js", joints_message(seconds, ("jaw",), readings))
        mask = cv2.imread(str(files[k].mask), cv2.IMREAD_GRAYSCALE) > 127
        server.send("/left/mask/compressed", mask_message(seconds, mask))

    with Live(*topics, "--camera", session / "camera.yaml", "--out", tmp_path / "live") as live:
        server = live.server
        until(lambda: len(server.subscribed) >= 4)
        play(server, 3, send, ("PSM1",))
        server.send_text("this is no message")
        server.send("/left/mask/compressed", {"header": 3})
        server.send("/left/mask/compressed", {**mask_message(0.35, np.ones((2, 2))), "data": "AAAA"})
        server.send(
            "/PSM1/measured_js", {**joints_message(0.35, ("yaw",), {"yaw": 0.1}), "effort": [0.123456] * 200_000}
        )
        server.send("/PSM1/measured_js", joints_message(9000.0, ("yaw",), {"yaw": 0.1}))
        send(3, 3600.0)  # an image of another time
        for k in range(4, 9):
            goal = {"PSM1": len(states(server, "PSM1")) + 1}
            send(k, k / 10)
            until(partial(said, server, goal))
        assert live.process.poll() is None  # no message ends it
        for k in range(9, 14):  # the clock was set
            send(k, 7200.0 + k / 10)
            time.sleep(0.05)
        until(lambda: bool(server.received["/diagnostics"][-1][1]["header"]["stamp"]["sec"] > START + 7000))
        found = states(server, "PSM1")
    assert all(state["level"] > 0 and state["message"] for state in found)
    assert live.code == 0
    assert live.out.count("\n") == 1
    assert "results published, 0 ok; " in live.out
    lines = live.err.splitlines()
    assert lines[-1].endswith("live: session.json of 1 of 1 arms not written: keyframes have not determined a base")
    assert all(line.startswith("dvrk-cmaes: ") for line in lines), live.err
    for expected in ("connected", "+3599", "at most 1 MB", "readings +8999", "/left/mask/compressed", "begins anew"):
        assert any(expected in line for line in lines), (expected, lines)


def test_two_arms_are_followed_by_both_eyes(kept: Kept) -> None:
    session = synth(kept, *PAIR)
    tracked = kept("track", session, "--out", OUT, *PLAIN).folder
    arms, sides = ("PSM1", "PSM2"), ("left", "right")
    topics = [
        *(
            "--psm",
            *arms,
            "--rectified",
            "--image-topic",
            "/left/image_rect",
            "--right-image-topic",
            "/right/image_rect",
        ),
        *("--mask-topic", *(f"/left/{arm}/mask/compressed" for arm in arms)),
        *("--right-mask-topic", *(f"/right/{arm}/mask/compressed" for arm in arms)),
    ]
    eyes = {side: read_camera(session / f"{side}.yaml", rectified=True) for side in sides}
    right = yaml.safe_load((session / "right.yaml").read_text())["projection_matrix"]["data"]
    baseline = -right[3] / right[0]
    tables = {arm: rows_of(session / f"joints_{arm}.csv") for arm in arms}
    with Live(*topics, "--session", tracked) as live:
        server = live.server
        until(lambda: len(server.subscribed) >= 8)

        def send(number: int, seconds: float) -> None:
            k = number % FRAMES
            for side, eye in eyes.items():
                server.send(f"/{side}/camera_info", camera_message(eye, baseline * (side == "right")))
            for arm in arms:
                server.send(f"/{arm}/measured_js", joints_message(seconds, OUTER, tables[arm][k]))
                server.send(f"/{arm}/jaw/measured_js", joints_message(seconds, ("jaw",), tables[arm][k]))
            for side in sides:
                labels = cv2.imread(str(session / "masks" / side / f"{k:04d}.png"), cv2.IMREAD_UNCHANGED)
                assert labels is not None
                for label, arm in enumerate(arms, start=1):
                    server.send(f"/{side}/{arm}/mask/compressed", mask_message(seconds, labels == label))

        play(server, FRAMES, send, arms)
        seen = {arm: poses(server, arm) for arm in arms}
        for arm, found in seen.items():
            errors = errors_of(found, truth(session, arm))
            assert len(errors) >= 5  # where time is short, the arms take turns
            assert median(errors) < 1.5
        for child in psutil.Process(live.process.pid).children(recursive=True):
            if "resource_tracker" not in " ".join(child.cmdline()):
                child.kill()  # those that follow an arm each, and their own
        for k in range(FRAMES, 10 * FRAMES):
            goals = {arm: len(states(server, arm)) + 1 for arm in arms}
            send(k, k / 10)
            until(partial(said, server, goals), 30)
            if all(max(poses(server, arm)) > max(seen[arm]) for arm in arms):
                break  # followed again
        else:
            pytest.fail("not followed again")
    assert "the process of this arm died" in live.err


def rows_of(path: Path) -> list[dict[str, float]]:
    """Read a table of readings, a mapping of each row."""
    head, *rows = path.read_text().splitlines()
    return [
        {name: float(value) for name, value in zip(head.split(","), row.split(","), strict=True) if name != "frame"}
        for row in rows
    ]


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
