"""`dvrk-cmaes live` over a websocket: poses a second, and their age from image to pose.

    python scripts/bench.py live --seconds 60

This needs the extra ros. Another process is the rosbridge server on 127.0.0.1. It sends the images and masks of a
recorded session, of all its arms and eyes, forwards and backwards, 30 a second unless --images says otherwise, and
readings of each arm, 100 a second unless --readings does. Images that are --late are so in both directions. It receives
the poses. The age is from sending the last mask of a time to receiving the pose there; of a set, the poses of all arms,
to the last of these. ``stated - true`` is the age in /diagnostics less that of its receipt. Memory is the resident set
of the following process, with those of several arms, without those that solve keyframes, in MB, after 10 s, after a
quarter of the time, at most two minutes, and at the end; its growth is that since the second.

Of arms with a truth, ok poses are counted that are in the wrong mode or came before the base was known, and the share
that is ok of the poses of images with at least half of the jaws in view, after it was.

With --solve, the arms' bases are found from keyframes in other processes, as by the command; with --losses, the masks
are a disc in the middle of the image for a quarter of a second each time; with --load, so many other processes compute
all the time. Ten minutes with one loss a minute, and five of two arms and two eyes:

    python scripts/bench.py live --seconds 600 --losses 60 --solve
    dvrk-cmaes synth two --motion video --arms 2 --stereo --level easy --frames 150
    python scripts/bench.py live --session two --instrument lnd --seconds 300 --solve
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Any, Final

import cv2
import numpy as np
import psutil
from examples.play_session import BEGIN, Robot, RosbridgeServer, header, png
from scipy.spatial.transform import Rotation

from dvrk_cmaes import load_instrument, prepare
from dvrk_cmaes.calibration.document import read_calibration
from dvrk_cmaes.cli.live import shown_state
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.frames.truth import read_golden
from dvrk_cmaes.geometry import rotation_angle
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.live.follow import ArmSetup, LiveSetup, follow
from dvrk_cmaes.live.inputs import EyeTopics, InputTopics
from dvrk_cmaes.live.rosbridge import RosbridgeConnection
from dvrk_cmaes.runs.live_session import prepare_long_run
from dvrk_cmaes.runs.solver_process import SolverProcess
from dvrk_cmaes.runs.worker_process import WorkerProcess
from measure.accuracy.figures import RIGHT_MODE_DEG
from measure.places import ROOT, SHARED
from measure.tables import Report

RECORDED: Final = 30  # images a second of the session
_LOSS: Final = 0.25  # s
UNKNOWN: Final = "base not known yet"
_IN_VIEW: Final = 0.5  # least share of the jaws in view
_MEMORY_FROM: Final = 10  # s
_SETTLED: Final = 120  # s


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--session", type=Path, default=SHARED / "frames/video/easy", help="of any arms and eyes")
    parser.add_argument("--calibration", type=Path, help="a session.json")
    parser.add_argument("--lag", type=float, help="lag of the images, s")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--images", type=float, default=30.0, metavar="RATE", help="images a second (30)")
    parser.add_argument("--readings", type=float, default=100.0, metavar="RATE", help="readings a second (100)")
    parser.add_argument("--begin", type=float, default=0.0, metavar="S", help="time in the session of the first image")
    parser.add_argument("--late", type=float, default=0.0, metavar="S", help="images of the session after its readings")
    parser.add_argument("--losses", type=float, metavar="S", help="time between losses, s (default: none)")
    parser.add_argument("--solve", action="store_true", help="solve keyframes beside")
    parser.add_argument("--load", type=int, default=0, metavar="N", help="other processes that compute (none)")
    parser.add_argument("--overlay", action="store_true", help="publish overlays too")


def topics_of(robot: Robot) -> InputTopics:
    """Return the topics of a recording."""
    eyes = {
        eye: EyeTopics(image, f"/{eye}/camera_info", masks if robot.masked else {})
        for eye, (image, masks) in robot.eyes.items()
    }
    return InputTopics(eyes, {arm: (topic,) for arm, topic in robot.joints.items()})


def live_report(options: argparse.Namespace) -> Report:
    """Run the measurement and return its figures."""
    robot, body = Robot(options.session), prepare(load_instrument(options.instrument))
    calibration = None if options.calibration is None else read_calibration(options.calibration)
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    sending = Sending(
        options.session,
        options.seconds,
        options.images,
        options.readings,
        options.losses,
        options.begin,
        options.late,
    )
    server = context.Process(target=serve, args=(theirs, sending), daemon=True)
    server.start()
    theirs.close()  # so that a server that fails ends this, too

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    prepare_long_run()
    connection = RosbridgeConnection("127.0.0.1", ours.recv(), say)
    connection.open(timeout=10.0)
    stop, memory = Event(), list[float]()
    Thread(target=_end, args=(ours, stop), daemon=True).start()
    started = time.process_time()
    with ExitStack() as stack:
        for _ in range(options.load):
            busy = context.Process(target=_compute, daemon=True)
            busy.start()
            stack.callback(busy.kill)
        others = [child.pid for child in psutil.Process().children()] if len(robot.arms) > 1 else None
        Thread(target=_watch, args=(stop, memory, others), daemon=True).start()
        arms = []
        for arm in robot.arms:
            solver = partial(SolverProcess, body.instrument, background=True) if options.solve else None
            arms.append(ArmSetup(FrameNames(arm, "camera", f"{arm}_base"), body, "classic", calibration, solver))
        rig, topics = robot.session.rig, topics_of(robot)
        apart = partial(WorkerProcess, for_long=True)
        setup = LiveSetup(topics, tuple(arms), EstimateConfig(), options.lag, rig, overlay=options.overlay, apart=apart)
        counts = follow(setup, connection, say, stop, show=stack.enter_context(shown_state()))
        used = time.process_time() - started
        figures = ours.recv()
        connection.close()
        server.join(10)
    settled = memory[min(max(round(min(options.seconds / 4, _SETTLED)) - _MEMORY_FROM, 0), len(memory) - 1)]
    figures |= {
        "followed": counts.followed,
        "refused": counts.refused,
        "cpu_share": round(used / options.seconds, 2),
        "memory_mb": [round(memory[0], 1), round(settled, 1), round(memory[-1], 1)],
        "growth_%": round(100 * (memory[-1] / settled - 1), 1),
    }
    return {"live": [figures]}


def _compute() -> None:
    """Use a core all the time."""
    while True:
        sum(range(100_000))


def _end(pipe: Any, stop: Event) -> None:
    """Set an event when the server has sent its figures, or has ended."""
    pipe.poll(None)
    stop.set()


def _watch(stop: Event, memory: list[float], others: Sequence[int] | None) -> None:
    """Sample the memory of this process, and of those that it starts beside ``others``, every second from 10 s on.

    Without ``others``, that of this process is all.
    """
    stop.wait(_MEMORY_FROM)
    while True:
        own = psutil.Process()
        used = [own, *(child for child in own.children() if others is not None and child.pid not in others)]
        memory.append(sum(one.memory_info().rss for one in used) / 1e6)
        if stop.wait(1):
            return


# the server's process


@dataclass(frozen=True)
class Sending:
    """What is sent: the session, for how long, s, images and readings a second, losses, and where it begins, s.

    ``losses`` is the time between losses, s, during which the mask is a disc; None for none. The session's images are
    ``late`` seconds later than its readings, and stay so when they are sent backwards.
    """

    folder: Path
    seconds: float
    images: float
    readings: float
    losses: float | None
    begin: float
    late: float

    def place(self, moment: float, count: int) -> float:
        """Return the place among the ``count`` images of the session at a time after the start, s."""
        return _back_and_forth((self.begin + moment) * RECORDED, count - 1)

    def loses(self, moment: float) -> bool:
        """Return whether masks are discs at a time after the start, s."""
        losses = self.losses
        return losses is not None and moment >= losses / 2 and (moment - losses / 2) % losses < _LOSS


@dataclass(frozen=True)
class Sent:
    """A message to send: its time after the start, s, its topic and its fields."""

    moment: float
    topic: str
    fields: dict[str, Any]


Messages = Sequence[tuple[float, dict[str, Any]]]
"""Messages with the time of their receipt, s."""


def serve(pipe: Any, sending: Sending) -> None:
    """Serve a session's messages in real time; send the port, and at the end the figures, through a pipe."""
    sys.path.insert(0, str(ROOT / "tests"))
    from helpers.waiting import wait_for  # type: ignore[import-not-found]

    robot = Robot(sending.folder)
    messages = list(_messages(robot, sending))
    server = RosbridgeServer()
    server.start()
    pipe.send(server.port)
    found = {arm: f"/dvrk_cmaes/{arm}/camera_from_root" for arm in robot.arms}
    wait_for(
        lambda: (
            {*robot.evidence, *robot.joints.values()} <= set(server.subscribed)
            and set(found.values()) <= set(server.advertised)
        ),
        60,
    )
    started, sent = time.perf_counter(), dict[tuple[int, int], float]()
    for one in messages:
        wait = started + one.moment - time.perf_counter()
        if wait > 0:
            time.sleep(wait)
        if one.topic in robot.evidence:
            sent[_key(one.fields)] = time.perf_counter()
        server.send(one.topic, one.fields)
    time.sleep(0.5)
    elapsed = time.perf_counter() - started - 0.5
    poses = {arm: server.received.get(topic, []) for arm, topic in found.items()}
    whole = _sets(list(poses.values()), sent)
    statuses = server.received.get("/diagnostics", [])
    stated = [age - 1e3 * (moment - sent[key]) for moment, key, age in _stated(statuses) if key in sent]
    pipe.send(
        {
            "seconds": round(elapsed, 2),
            "images_a_second": round(len(sent) / elapsed, 2),
            "poses_a_second": {arm: round(len(of_arm) / elapsed, 2) for arm, of_arm in poses.items()},
            "sets_a_second": round(len(whole) / elapsed, 2),
            **_quantiles("age_ms", whole),
            **_quantiles("stated - true, ms", stated, (1, 50, 99)),
            "load": round(psutil.getloadavg()[0], 1),
            **{arm: _trust(session, sending, poses[arm], statuses, arm) for arm, session in robot.arms.items()},
        }
    )
    server.stop()


def _quantiles(name: str, values: Sequence[float], shares: Sequence[int] = (50, 95, 99, 100)) -> dict[str, float]:
    """Return quantiles of values by name and share, %."""
    return {f"{name} p{share}": round(float(np.percentile(values or [np.nan], share)), 1) for share in shares}


def _sets(poses: Sequence[Messages], sent: Mapping[tuple[int, int], float]) -> list[float]:
    """Return the ages, ms, of sets of poses of all arms, from the last mask to the last pose."""
    received = [{_key(fields): moment for moment, fields in of_arm} for of_arm in poses]
    common = set[tuple[int, int]].intersection(*(set(of_arm) for of_arm in received))
    return [1e3 * (max(of_arm[key] for of_arm in received) - sent[key]) for key in common]


def _stated(statuses: Messages) -> Iterator[tuple[float, tuple[int, int], float]]:
    """Yield the receipt, s, the stamp and the stated age, ms, of the statuses of images."""
    for moment, fields in statuses:
        values = {one["key"]: one["value"] for one in fields["status"][0]["values"]}
        if "age_ms" in values:
            yield moment, _key(fields), float(values["age_ms"])


def _key(fields: dict[str, Any]) -> tuple[int, int]:
    """Return the stamp of a message."""
    stamp = fields["header"]["stamp"]
    return stamp["sec"], stamp["nanosec"]


def _trust(session: Session, sending: Sending, poses: Messages, statuses: Messages, arm: str) -> dict[str, Any]:
    """Compare poses with the truth of the session, if it has one, and with what the statuses say of the base."""
    golden = session.folder / f"golden_{arm}.json"
    truth_of = read_golden(golden) if golden.exists() else session.truth
    truths = [truth_of.frames.get(frame.name) for frame in session.frames]
    if None in truths:
        return {}
    found = {_key(fields): fields["pose"] for _, fields in poses}
    counts = Counter(ok_wrong_mode=0, ok_before_base=0, in_view_after_base=0, ok_in_view_after_base=0)
    first, reasons = None, Counter[str]()
    for _, fields in statuses:
        (status,) = fields["status"]
        if status["hardware_id"] != arm:
            continue
        values = {one["key"]: one["value"] for one in status["values"]}
        moment = (_key(fields)[0] * NANOSECONDS + _key(fields)[1] - BEGIN * NANOSECONDS) / NANOSECONDS
        if "age_ms" not in values:  # why there is no pose
            continue
        truth = truths[round(sending.place(moment, len(truths)))]
        assert truth is not None
        ok, state = status["message"] == "ok", values.get("calibration", UNKNOWN)
        known = UNKNOWN not in state
        first = moment if known and first is None else first
        reasons[status["message"] + " " + values["reasons"].split(":")[0]] += 1
        counts["ok_before_base"] += ok and not known
        in_view = known and truth.visible >= _IN_VIEW
        counts["in_view_after_base"] += in_view
        counts["ok_in_view_after_base"] += ok and in_view
        if ok and _key(fields) in found:
            pose = Rotation.from_quat([found[_key(fields)]["orientation"][axis] for axis in "xyzw"])
            turned = rotation_angle(pose.as_matrix(), truth.camera_from_root)
            counts["ok_wrong_mode"] += bool(np.degrees(turned) > RIGHT_MODE_DEG)
    share = counts["ok_in_view_after_base"] / max(counts["in_view_after_base"], 1)
    return {**counts, "ok_after_base_%": round(100 * share, 1), "base_known_after_s": first, "statuses": dict(reasons)}


def _messages(robot: Robot, sending: Sending) -> Iterator[Sent]:
    """Yield the messages of a session in the order of their times, forwards and backwards for some seconds."""
    count = len(robot.session.frames)
    frames = [dict(robot.pictures(number)) for number in range(count)]
    later = list[Sent]()
    camera = robot.session.rig.camera
    disc = _disc(camera.height, camera.width)
    images = {image for image, _ in robot.eyes.values()}
    for k in range(round(sending.seconds * sending.images)):
        moment = k / sending.images
        for topic, data in frames[round(sending.place(moment, count))].items():
            own = topic in images
            sent = disc if sending.loses(moment) and not own else data
            fields = {"header": header(moment), "format": "jpeg" if own else "png", "data": sent}
            later.append(Sent(moment if own else moment + 1e-4, topic, fields))
    for arm, topic in robot.joints.items():
        times, values = robot.readings(arm)
        for k in range(round(sending.seconds * sending.readings)):
            moment = k / sending.readings
            at = times[0] + sending.place(moment + sending.late, count) / RECORDED - sending.late
            position = [float(np.interp(at, times, column)) for column in values.values()]
            later.append(Sent(moment, topic, {"header": header(moment), "name": list(values), "position": position}))
    yield from sorted(later, key=lambda one: one.moment)


def _disc(height: int, width: int) -> str:
    """Return the mask of a disc in the middle of an image, which no instrument has."""
    pixels = np.zeros((height, width), dtype=np.uint8)
    return png(cv2.circle(pixels, (width // 2, height // 2), height // 8, 1, cv2.FILLED))


def _back_and_forth(k: float, last: int) -> float:
    """Return a position from 0 to ``last`` that goes forwards and backwards as k grows."""
    return last - abs(k % (2 * last) - last)
