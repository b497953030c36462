"""Play a recording over rosbridge's protocol, as a robot would send it, to try ``dvrk-cmaes live`` without one.

    pip install '.[ros]' tornado
    dvrk-cmaes synth session --motion video --level easy --frames 150
    python scripts/examples/play_session.py session

It prints the command that follows what is sent. The argument is a session folder with consecutive images or masks, of
one eye or both. Those of two arms have joints_PSM1.csv and joints_PSM2.csv, and masks with the labels 1 and 2.
"""

from __future__ import annotations

import asyncio
import base64
import json
import socket
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from dvrk_cmaes import DvrkCmaesError, Session, read_session

BEGIN = 1_795_000_000  # s, the time of the first image
RATE = 30.0  # images a second of a session without times


class RosbridgeServer:
    """Serves the part of rosbridge's protocol that a client of topics needs, on a port of 127.0.0.1.

    ``received`` has the messages of each topic that clients published, each with the time of its receipt, s. ``topics``
    are those that the service rosapi/topics tells, with their types. It may be started again on the same port.
    """

    def __init__(self, port: int = 0) -> None:
        self.port = port
        self.received: dict[str, list[tuple[float, dict[str, Any]]]] = {}
        self.advertised: dict[str, str] = {}
        self.subscribed: dict[str, dict[str, Any]] = {}
        self.refused: list[str] = []
        self.topics: dict[str, str] = {}
        self.clients: set[WebSocketHandler] = set()

    def start(self) -> None:
        """Serve on another thread."""
        sockets, started = bind_sockets(self.port, "127.0.0.1"), threading.Event()
        self.port = sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(sockets, started)), daemon=True)
        self._thread.start()
        assert started.wait(60)

    def stop(self) -> None:
        """Close all connections and the port."""
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(60)
        assert not self._thread.is_alive()

    def send(self, topic: str, message: Mapping[str, Any]) -> None:
        """Send a message to the clients that have subscribed to its topic."""
        if topic in self.subscribed:
            self.send_text(json.dumps({"op": "publish", "topic": topic, "msg": message}))

    def send_text(self, text: str) -> None:
        """Send a text as it is to all clients."""
        self._loop.call_soon_threadsafe(self._write, text)

    def _write(self, text: str) -> None:
        for client in list(self.clients):
            try:
                client.write_message(text)
            except WebSocketClosedError:
                self.clients.discard(client)

    async def _serve(self, sockets: list[socket.socket], started: threading.Event) -> None:
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        self.subscribed.clear()
        self.advertised.clear()
        server = HTTPServer(Application([("/", Client, {"server": self})], websocket_max_message_size=10**8))
        server.add_sockets(sockets)
        started.set()
        await self._ended.wait()
        server.stop()
        for client in list(self.clients):
            client.close()
        await server.close_all_connections()

    def take(self, text: str) -> None:
        """Carry out an operation of a client."""
        message = json.loads(text)
        if message["op"] == "call_service":
            values = {"topics": list(self.topics), "types": list(self.topics.values())}
            self.send_text(json.dumps({"op": "service_response", "service": message["service"], "values": values}))
            return
        topic = message["topic"]
        if message["op"] == "subscribe":
            self.subscribed[topic] = message
        elif message["op"] == "advertise":
            self.advertised[topic] = message["type"]
        elif message["op"] == "publish" and topic in self.advertised:
            self.received.setdefault(topic, []).append((time.perf_counter(), message["msg"]))
        else:
            self.refused.append(text)


class Client(WebSocketHandler):
    """A connection to the server."""

    def initialize(self, server: RosbridgeServer) -> None:
        """Keep the server."""
        self._server = server

    def check_origin(self, origin: str) -> bool:
        """Accept all."""
        return True

    def open(self, *args: str, **kwargs: str) -> None:
        """Add the client to those that messages are sent to."""
        self.set_nodelay(True)  # as rosbridge_server does: else the end of a message waits some 40 ms
        self._server.clients.add(self)

    def on_close(self) -> None:
        """Send it no more messages."""
        self._server.clients.discard(self)

    def on_message(self, message: str | bytes) -> None:
        """Carry out an operation."""
        self._server.take(message if isinstance(message, str) else message.decode())


class Robot:
    """The topics of a recording: ``arms`` has the session of each arm, which share images and cameras."""

    def __init__(self, folder: str | Path) -> None:
        several = sorted(Path(folder).glob("joints_*.csv"))
        named = {path.stem.removeprefix("joints_"): read_session(folder, joints=[path]) for path in several}
        self.arms: dict[str, Session] = named or {"PSM1": read_session(folder)}
        self.session = next(iter(self.arms.values()))
        self.masked = all(files.mask is not None for files in self.session.frames)
        self.eyes = {
            eye: (f"/{eye}/image/compressed", {arm: f"/{eye}/{arm}/mask/compressed" for arm in self.arms})
            for eye in self.session.rig.names
        }
        self.joints = {arm: f"/{arm}/measured_js" for arm in self.arms}

    @property
    def evidence(self) -> list[str]:
        """The topics of which each frame needs a message."""
        return [topic for image, masks in self.eyes.values() for topic in (masks.values() if self.masked else [image])]

    @property
    def options(self) -> str:
        """The options with which ``live`` follows what is sent."""
        (left, left_masks), *right = self.eyes.values()
        texts = [f"--psm {' '.join(self.arms)} --image-topic {left}"]
        texts += [f"--mask-topic {' '.join(left_masks.values())}"] if self.masked else []
        for image, masks in right:
            texts.append(f"--right-image-topic {image}")
            texts += [f"--right-mask-topic {' '.join(masks.values())}"] if self.masked else []
        return " ".join(texts)

    def cameras(self) -> dict[str, dict[str, Any]]:
        """Give the CameraInfo of each eye, by topic."""
        found = {}
        for view in self.session.rig.views:
            camera, moved = view.camera, view.view_from_camera
            found[f"/{view.name}/camera_info"] = {
                "header": header(0.0),
                "width": camera.width,
                "height": camera.height,
                "distortion_model": "plumb_bob",
                "d": list(camera.distortion) or [0.0] * 5,
                "k": camera.matrix.ravel().tolist(),
                "r": np.eye(3).ravel().tolist(),
                "p": np.c_[camera.matrix, camera.matrix @ moved[:3, 3]].ravel().tolist(),
            }
        return found

    def pictures(self, number: int) -> Iterator[tuple[str, str]]:
        """Give the images and masks of a frame by topic, as PNG or JPEG in base64."""
        files = self.session.frames[number]
        for eye, of_eye in files.of_views(self.session.rig).items():
            image, masks = self.eyes[eye]
            if of_eye.image is not None:
                yield image, base64.b64encode(of_eye.image.read_bytes()).decode()
            if of_eye.mask is not None and self.masked:
                labels = cv2.imread(str(of_eye.mask), cv2.IMREAD_GRAYSCALE)
                assert labels is not None, of_eye.mask
                for label, topic in enumerate(masks.values(), start=1):
                    yield topic, png(labels == label if len(masks) > 1 else labels > 127)

    def readings(self, arm: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Give the times (N,) of an arm's readings, s, and the values (N,) of its joints at these, rad and m."""
        series = self.arms[arm].reading_series()
        assert series is not None, "the session has no readings"
        times = np.unique(np.concatenate(list(series.times.values())))
        values = {name: np.interp(times, series.times[name], series.values[name]) for name in series.times}
        return times / (1.0 if series.unit == "s" else RATE), values

    def times(self) -> np.ndarray:
        """Give the times (F,) of the frames, s."""
        series = self.session.reading_series()
        assert series is not None, "the session has no readings"
        return np.array(list(series.frames.values())) / (1.0 if series.unit == "s" else RATE)

    def messages(self) -> list[tuple[float, str, dict[str, Any]]]:
        """Give all messages with their times, s, and topics, in the order of their times."""
        found = list[tuple[float, str, dict[str, Any]]]()
        for arm, topic in self.joints.items():
            times, values = self.readings(arm)
            jaw = {name: values.pop(name) for name in ("jaw",) if name in values}  # a topic of its own, as of a robot
            for own, read in ((topic, values), (f"/{arm}/jaw/measured_js", jaw)):
                for k, moment in enumerate(times.tolist() if read else ()):
                    fields = {"name": list(read), "position": [float(column[k]) for column in read.values()]}
                    found.append((moment, own, {"header": header(moment), **fields}))
        for number, moment in enumerate(self.times().tolist()):
            for topic, data in self.pictures(number):
                found.append((moment, topic, {"header": header(moment), "format": "png", "data": data}))
        return sorted(found, key=lambda one: one[0])


def header(moment: float) -> dict[str, Any]:
    """Give the header of a time, s."""
    seconds, rest = divmod(round(moment * 1e9), 10**9)
    return {"stamp": {"sec": BEGIN + seconds, "nanosec": rest}, "frame_id": "camera"}


def png(mask: np.ndarray) -> str:
    """Give a mask as PNG in base64."""
    return base64.b64encode(cv2.imencode(".png", 255 * mask.astype(np.uint8))[1].tobytes()).decode()


def main(folder: str, port: int = 9090) -> None:
    """Send a session folder's messages once, when a client has subscribed to them; ``port`` 0 is any that is free."""
    robot, server = Robot(folder), RosbridgeServer(port)
    messages = robot.messages()  # before a client waits for the first one
    kinds = (robot.cameras(), "CameraInfo"), (robot.evidence, "CompressedImage"), (robot.joints.values(), "JointState")
    server.topics = {topic: f"sensor_msgs/{kind}" for topics, kind in kinds for topic in topics}
    server.start()
    print(f"dvrk-cmaes live --port {server.port} {robot.options}", flush=True)
    while not {*robot.evidence, *robot.joints.values()} <= server.subscribed.keys():
        time.sleep(0.1)
    for topic, info in robot.cameras().items():
        server.send(topic, info)
    began = time.monotonic() - messages[0][0]
    for moment, topic, fields in messages:
        time.sleep(max(0.0, began + moment - time.monotonic()))
        server.send(topic, fields)
    time.sleep(1.0)
    for topic, received in sorted(server.received.items()):
        print(f"{topic}: {len(received)}")
    server.stop()


if __name__ == "__main__":
    try:
        main(sys.argv[1], *map(int, sys.argv[2:3]))
    except (IndexError, ValueError, OSError, DvrkCmaesError) as error:
        print(f"expected a session folder with readings, and a port that is free: {error}", file=sys.stderr)
        sys.exit(2)
