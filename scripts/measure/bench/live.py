"""`dvrk-cmaes live` over a websocket: poses a second, and their age from image to pose.

    python scripts/bench.py live --seconds 60

This needs the extra ros. Another process is the rosbridge server on 127.0.0.1. It sends the images and masks of a
recorded session, forwards and backwards, 30 a second unless --images says otherwise, and readings of arm and jaw, 100 a
second each unless --readings does; at equal rates they have the same times. It receives the poses. The age is from
sending an image's mask to receiving its pose there. Memory is the resident set of the following process, in MB, after
10 s, after a quarter of the time, and at the end; its growth is that since the quarter.

Of a session with a truth, ok poses are counted that are in the wrong mode or came before the base was known, and the
share that is ok of the poses of images with at least half of the jaws in view, after it was.

With --solve, the arm's base is found from keyframes in another process, as by the command; with --losses, the mask is a
disc in the middle of the image for a quarter of a second each time. Ten minutes with one loss a minute:

    python scripts/bench.py live --seconds 600 --losses 60 --solve
"""

from __future__ import annotations

import argparse
import base64
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Thread
from typing import Any, Final

import cv2
import numpy as np
import psutil
from scipy.spatial.transform import Rotation

from dvrk_cmaes.calibration.document import read_calibration
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.geometry import rotation_angle
from dvrk_cmaes.instrument import load_instrument
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.names import ARM_ORDER
from dvrk_cmaes.live.follow import LiveSetup, follow
from dvrk_cmaes.live.inputs import InputTopics
from dvrk_cmaes.live.rosbridge import RosbridgeConnection
from dvrk_cmaes.recording.reading_table import read_timed_joints
from dvrk_cmaes.runs.long_run import prepare_long_run
from dvrk_cmaes.runs.solver_process import SolverProcess
from dvrk_cmaes.silhouette import Body
from measure.accuracy.figures import RIGHT_MODE_DEG
from measure.places import ROOT, SHARED
from measure.tables import Report

RECORDED: Final = 30  # images a second of the session
_LOSS: Final = 0.25  # s
UNKNOWN: Final = "base not known yet"
_IN_VIEW: Final = 0.5  # least share of the jaws in view
_MEMORY_FROM: Final = 10  # s
BEGIN: Final = 1_795_000_000 * NANOSECONDS
POSE: Final = "/dvrk_cmaes/PSM1/camera_from_root"
TOPICS: Final = InputTopics(
    "/left/image/compressed",
    "/left/camera_info",
    ("/PSM1/measured_js", "/PSM1/jaw/measured_js"),
    "/left/mask/compressed",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "--session", type=Path, default=SHARED / "frames/video/easy", help="masks, joints.csv with times"
    )
    parser.add_argument("--calibration", type=Path, help="a session.json")
    parser.add_argument("--lag", type=float, help="lag of the images, s")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--images", type=float, default=30.0, metavar="RATE", help="images a second (30)")
    parser.add_argument("--readings", type=float, default=100.0, metavar="RATE", help="readings a second (100)")
    parser.add_argument("--begin", type=float, default=0.0, metavar="S", help="time in the session of the first image")
    parser.add_argument("--losses", type=float, metavar="S", help="time between losses, s (default: none)")
    parser.add_argument("--solve", action="store_true", help="solve keyframes beside")
    parser.add_argument("--overlay", action="store_true", help="publish overlays too")


def live_report(options: argparse.Namespace) -> Report:
    """Run the measurement and return its figures."""
    session = read_session(options.session)
    instrument = load_instrument(options.instrument)
    calibration = None if options.calibration is None else read_calibration(options.calibration)
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    sending = Sending(options.session, options.seconds, options.images, options.readings, options.losses, options.begin)
    given = (theirs, sending)
    server = context.Process(target=serve, args=given, daemon=True)
    server.start()
    setup = LiveSetup(
        TOPICS,
        FrameNames(),
        Body.prepare(instrument),
        calibration=calibration,
        camera=session.camera,
        lag=options.lag,
        overlay=options.overlay,
    )

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    prepare_long_run()
    connection = RosbridgeConnection("127.0.0.1", ours.recv(), say)
    connection.open(timeout=10.0)
    stop, memory = Event(), list[float]()
    watch = Thread(target=_watch, args=(stop, memory), daemon=True)
    watch.start()
    Thread(target=_end, args=(ours, stop), daemon=True).start()
    started = time.process_time()
    with SolverProcess(instrument, background=True) if options.solve else nullcontext() as solver:
        counts = follow(replace(setup, solver=solver), connection, say, stop)
        used = time.process_time() - started
        figures = ours.recv()
        connection.close()
        server.join(10)
    quarter = memory[min(max(round(options.seconds / 4) - _MEMORY_FROM, 0), len(memory) - 1)]
    figures |= {
        "followed": counts.followed,
        "refused": counts.refused,
        "cpu_share": round(used / options.seconds, 2),
        "memory_mb": [round(memory[0], 1), round(quarter, 1), round(memory[-1], 1)],
        "growth_%": round(100 * (memory[-1] / quarter - 1), 1),
    }
    return {"live": [figures]}


def _end(pipe: Any, stop: Event) -> None:
    """Set an event when the server has sent its figures, or has ended."""
    pipe.poll(None)
    stop.set()


def _watch(stop: Event, memory: list[float]) -> None:
    """Sample the memory of this process every second, the first time after 10 s."""
    stop.wait(_MEMORY_FROM)
    while True:
        memory.append(psutil.Process().memory_info().rss / 1e6)
        if stop.wait(1):
            return


# the server's process


@dataclass(frozen=True)
class Sending:
    """What is sent: the session, for how long, s, images and readings a second, losses, and where it begins, s.

    ``losses`` is the time between losses, s, during which the mask is a disc; None for none.
    """

    folder: Path
    seconds: float
    images: float
    readings: float
    losses: float | None
    begin: float

    def place(self, moment: float, count: int) -> float:
        """Return the place among the ``count`` images of the session at a time after the start, s."""
        return _back_and_forth((self.begin + moment) * RECORDED, count - 1)


@dataclass(frozen=True)
class Sent:
    """A message to send: its time after the start, s, its topic and its fields."""

    moment: float
    topic: str
    fields: dict[str, Any]


def serve(pipe: Any, sending: Sending) -> None:
    """Serve a session's messages in real time; send the port, and at the end the figures, through a pipe."""
    sys.path.insert(0, str(ROOT / "tests"))
    from helpers.rosbridge_server import RosbridgeServer, wait_for  # type: ignore[import-not-found]

    session = read_session(sending.folder)
    messages = list(_messages(session, sending))
    server = RosbridgeServer()
    server.start()
    pipe.send(server.port)
    wait_for(lambda: len(server.subscribed) == 5 and POSE in server.advertised, 60)
    started, sent = time.perf_counter(), dict[tuple[int, int], float]()
    for one in messages:
        wait = started + one.moment - time.perf_counter()
        if wait > 0:
            time.sleep(wait)
        if one.topic == TOPICS.mask:
            sent[_key(one.fields)] = time.perf_counter()
        server.send(one.topic, one.fields)
    time.sleep(0.5)
    elapsed = time.perf_counter() - started - 0.5
    received = server.received.get(POSE, [])
    ages = np.array([1e3 * (moment - sent[_key(fields)]) for moment, fields in received] or [np.nan])
    pipe.send(
        {
            "seconds": round(elapsed, 2),
            "images_a_second": round(len(sent) / elapsed, 2),
            "poses_a_second": round(len(received) / elapsed, 2),
            **{f"age_ms p{share}": round(float(np.percentile(ages, share)), 1) for share in (50, 95, 99, 100)},
            "load": round(psutil.getloadavg()[0], 1),
            **_trust(session, sending, received, server.received.get("/diagnostics", [])),
        }
    )
    server.stop()


def _key(fields: dict[str, Any]) -> tuple[int, int]:
    """Return the stamp of a message."""
    stamp = fields["header"]["stamp"]
    return stamp["sec"], stamp["nanosec"]


def _trust(
    session: Session,
    sending: Sending,
    poses: Sequence[tuple[float, dict[str, Any]]],
    statuses: Sequence[tuple[float, dict[str, Any]]],
) -> dict[str, Any]:
    """Compare poses with the truth of the session, if it has one, and with what the statuses say of the base."""
    truths = [session.truth.frames.get(frame.name) for frame in session.frames]
    if None in truths:
        return {}
    found = {_key(fields): fields["pose"] for _, fields in poses}
    counts = Counter(ok_wrong_mode=0, ok_before_base=0, in_view_after_base=0, ok_in_view_after_base=0)
    first, reasons = None, Counter[str]()
    for _, fields in statuses:
        (status,) = fields["status"]
        values = {one["key"]: one["value"] for one in status["values"]}
        moment = (_key(fields)[0] * NANOSECONDS + _key(fields)[1] - BEGIN) / NANOSECONDS
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


def _messages(session: Session, sending: Sending) -> Iterator[Sent]:
    """Yield the messages of a session in the order of their times, forwards and backwards for some seconds."""
    seconds, losses = sending.seconds, sending.losses
    images = _images(session.folder)
    masks = [base64.b64encode(frame.mask.read_bytes()).decode() for frame in session.frames if frame.mask is not None]
    disc = _disc(session.camera)
    (table,) = read_timed_joints(session.folder / "joints.csv")
    times = (table.times - table.times[0]) / NANOSECONDS
    count = min(len(images), len(masks))
    later = list[Sent]()
    for k in range(round(seconds * sending.images)):
        moment = k / sending.images
        frame = sending.place(moment, count)
        lost = losses is not None and moment >= losses / 2 and (moment - losses / 2) % losses < _LOSS
        later.append(
            Sent(moment, TOPICS.image, {"header": _header(moment), "format": "jpeg", "data": images[round(frame)]})
        )
        later.append(
            Sent(
                moment + 1e-4,
                str(TOPICS.mask),
                {"header": _header(moment), "format": "png", "data": disc if lost else masks[round(frame)]},
            )
        )
    for k in range(round(seconds * sending.readings)):
        moment = k / sending.readings
        at = sending.place(moment, count) / RECORDED
        row = dict(zip(table.joints, [float(np.interp(at, times, column)) for column in table.values.T], strict=True))
        for topic, names in zip(TOPICS.joints, (ARM_ORDER, ("jaw",)), strict=True):
            fields = {"header": _header(moment), "name": list(names), "position": [row[name] for name in names]}
            later.append(Sent(moment, topic, fields))
    yield from sorted(later, key=lambda one: one.moment)


def _disc(camera: Camera) -> str:
    """Return the mask of a disc in the middle of a camera's image, which no instrument has, as PNG in base64."""
    pixels = np.zeros((camera.height, camera.width), dtype=np.uint8)
    cv2.circle(pixels, (camera.width // 2, camera.height // 2), camera.height // 8, 255, cv2.FILLED)
    return base64.b64encode(cv2.imencode(".png", pixels)[1].tobytes()).decode()


def _back_and_forth(k: float, last: int) -> float:
    """Return a position from 0 to ``last`` that goes forwards and backwards as k grows."""
    return last - abs(k % (2 * last) - last)


def _header(moment: float) -> dict[str, Any]:
    """Return a header, at a time after the beginning, s."""
    seconds, rest = divmod(BEGIN + round(moment * NANOSECONDS), NANOSECONDS)
    return {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": "camera"}


def _images(folder: Path) -> Sequence[str]:
    """Return the frames of a session's video as JPEG in base64."""
    video, images = cv2.VideoCapture(str(folder / "video.mp4")), list[str]()
    while True:
        found, pixels = video.read()
        if not found:
            return images
        images.append(base64.b64encode(cv2.imencode(".jpg", pixels)[1].tobytes()).decode())
