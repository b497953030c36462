"""`dvrk-cmaes live` over a websocket: poses a second, their age from image to pose, and memory.

The command follows what a robot would send: images and masks of a session, of all its arms and eyes, forwards and
backwards, 30 a second, and readings of each arm, 100 a second. The age of a set, the poses of all arms at a time, is
from sending its last mask to receiving its last pose; ``stated - true`` is the age in /diagnostics less that. Memory is
the resident set of the command's processes after 10 s, after a quarter of the time, at most two minutes, and at the
end. Of arms with a truth, ok poses in the wrong mode are counted. With --losses, the masks are a disc in the middle of
the image for a quarter of a second each time; with --out, the arms' bases are found from keyframes and kept there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from threading import Event, Thread
from typing import Any, Final

import cv2
import numpy as np
import psutil
from examples.play_session import BEGIN, Robot, RosbridgeServer, header, png
from scipy.spatial.transform import Rotation

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.geometry import rotation_angle
from measuring.report import SHARED, Report
from measuring.runner import goldens
from measuring.scorer import RIGHT_MODE_DEG

RATE: Final = 30.0  # images a second of the session
READINGS: Final = 100.0  # a second
_LOSS: Final = 0.25  # s
_MEMORY_FROM, _SETTLED = 10, 120  # s

Key = tuple[int, int]
Messages = Sequence[tuple[float, Mapping[str, Any]]]
"""Messages with the time of their receipt, s."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--session", type=Path, default=SHARED / "frames/video/easy", help="of any arms and eyes")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--losses", type=float, metavar="S", help="time between losses, s (default: none)")


def live_report(options: argparse.Namespace) -> Report:
    """Run the measurement and return its figures."""
    robot, server, stop, memory = Robot(options.session), RosbridgeServer(), Event(), list[float]()
    server.start()
    with tempfile.TemporaryDirectory() as place:
        line = [sys.executable, "-m", "dvrk_cmaes", "live", "--port", str(server.port), *robot.options.split()]
        line += ["--instrument", options.instrument, "--out", f"{place}/out", *options.further]
        with subprocess.Popen(line, stdout=subprocess.DEVNULL) as process:
            Thread(target=_watch, args=(process.pid, stop, memory), daemon=True).start()
            try:
                sent, elapsed = _send(robot, server, process, options.seconds, options.losses)
            finally:
                stop.set()
                process.terminate()
    server.stop()
    poses = {arm: server.received.get(f"/dvrk_cmaes/{arm}/camera_from_root", []) for arm in robot.arms}
    statuses = server.received.get("/diagnostics", [])
    received = [{_key(fields): moment for moment, fields in own} for own in poses.values()]
    whole = set[Key](sent).intersection(*received)
    ages = [1e3 * (max(own[key] for own in received) - sent[key]) for key in whole]
    stated = [age - 1e3 * (at - sent[key]) for at, key, age in _stated(statuses) if key in sent]
    settled = memory[min(max(round(min(elapsed / 4, _SETTLED)) - _MEMORY_FROM, 0), len(memory) - 1)]
    row: dict[str, Any] = {"seconds": round(elapsed, 1), "images a second": len(sent) / elapsed}
    row |= {f"{arm}, poses a second": len(own) / elapsed for arm, own in poses.items()}
    row |= {"sets a second": len(whole) / elapsed}
    row |= {f"age, ms, {share} %": float(np.percentile(ages or [np.nan], share)) for share in (50, 95, 99, 100)}
    row |= {"stated - true, ms, median": float(np.median(stated or [np.nan]))}
    row |= {"MB": [memory[0], settled, memory[-1]], "grown, %": 100 * (memory[-1] / settled - 1)}
    return {"live": [row], "arms": [_of_arm(robot, options.session, arm, poses[arm], statuses) for arm in robot.arms]}


def _send(
    robot: Robot, server: RosbridgeServer, process: subprocess.Popen[bytes], seconds: float, losses: float | None
) -> tuple[dict[Key, float], float]:
    """Send a session for some seconds; return when the last mask of each time was sent, and how long it took, s."""
    count = len(robot.session.frames)
    pictures = [dict(robot.pictures(number)) for number in range(count)]
    readings = {topic: robot.readings(arm) for arm, topic in robot.joints.items()}
    camera = robot.session.rig.camera
    disc = png(
        cv2.circle(
            np.zeros((camera.height, camera.width), np.uint8), (camera.width // 2, camera.height // 2), 60, 1, -1
        )
    )
    while not {*robot.evidence, *robot.joints.values()} <= server.subscribed.keys():
        if process.poll() is not None:
            raise DvrkCmaesError(f"live ended with {process.returncode}")
        for topic, info in robot.cameras().items():
            server.send(topic, info)
        time.sleep(0.2)
    for topic, info in robot.cameras().items():
        server.send(topic, info)
    steps = [(k / RATE, True) for k in range(round(seconds * RATE))]
    steps += [(k / READINGS, False) for k in range(round(seconds * READINGS))]
    sent, began = dict[Key, float](), time.perf_counter()
    for moment, is_image in sorted(steps):
        time.sleep(max(0.0, began + moment - time.perf_counter()))
        place = (count - 1) - abs((moment * RATE) % (2 * (count - 1)) - (count - 1))  # forwards and backwards
        stamp = header(moment)
        if not is_image:
            for topic, (times, values) in readings.items():
                at = [float(np.interp(times[0] + place / RATE, times, column)) for column in values.values()]
                server.send(topic, {"header": stamp, "name": [*values], "position": at})
            continue
        lost = losses is not None and moment >= losses / 2 and (moment - losses / 2) % losses < _LOSS
        for topic, data in pictures[round(place)].items():
            of_mask = topic in robot.evidence and robot.masked
            server.send(topic, {"header": stamp, "format": "png", "data": disc if lost and of_mask else data})
        sent[_key({"header": stamp})] = time.perf_counter()
    time.sleep(0.5)
    return sent, time.perf_counter() - began - 0.5


def _watch(pid: int, stop: Event, memory: list[float]) -> None:
    """Sample the memory of a command and its processes, MB, every second from 10 s on."""
    stop.wait(_MEMORY_FROM)
    while not stop.wait(1) or not memory:
        own = psutil.Process(pid)
        memory.append(sum(one.memory_info().rss for one in (own, *own.children())) / 1e6)


def _stated(statuses: Messages) -> Iterator[tuple[float, Key, float]]:
    """Yield the receipt, s, the stamp and the stated age, ms, of the statuses of images."""
    for moment, fields in statuses:
        values = {one["key"]: one["value"] for one in fields["status"][0]["values"]}
        if "age_ms" in values:
            yield moment, _key(fields), float(values["age_ms"])


def _key(fields: Mapping[str, Any]) -> Key:
    """Return the stamp of a message."""
    stamp = fields["header"]["stamp"]
    return stamp["sec"], stamp["nanosec"]


def _of_arm(robot: Robot, session: Path, arm: str, poses: Messages, statuses: Messages) -> dict[str, Any]:
    """Count the statuses of an arm, and its ok poses in the wrong mode where there is a truth."""
    truths = goldens(session)
    golden = truths.get(arm, truths.get(None))
    found, counts, wrong = {_key(fields): fields["pose"]["pose"] for _, fields in poses}, Counter[str](), 0
    count = len(robot.session.frames)
    for _, fields in statuses:
        (status,) = fields["status"]
        key = _key(fields)
        if status["hardware_id"] != arm or "age_ms" not in {one["key"] for one in status["values"]}:
            continue
        counts[status["message"]] += 1
        if golden is None or status["message"] != "ok" or key not in found:
            continue
        moment = key[0] - BEGIN + 1e-9 * key[1]
        place = round((count - 1) - abs((moment * RATE) % (2 * (count - 1)) - (count - 1)))
        truth = golden["frames"][robot.session.frames[place].name]
        turn = Rotation.from_quat([found[key]["orientation"][axis] for axis in "xyzw"]).as_matrix()
        wrong += bool(np.degrees(rotation_angle(turn, np.array(truth["T_camera_roll_link"]))) > RIGHT_MODE_DEG)
    return {"arm": arm, "statuses": json.dumps(counts), "ok in the wrong mode": wrong}
