"""Connection to ROS over a websocket, to a rosbridge server, with the library roslibpy.

The connection is opened again whenever it is lost. Messages are published only while it is open and the server takes
them; others are dropped, so that memory does not grow and what arrives is new.

Messages are assigned to their topics here, not by roslibpy, whose events of topics and of the connection share names.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from functools import partial
from threading import Event
from typing import Any, Final

from dvrk_cmaes.errors import missing_library, one_line
from dvrk_cmaes.live.connection import LARGEST_IMAGE, LARGEST_MESSAGE, Connection, Receive, Report, too_large

_LONGEST_WAIT: Final = 2.0  # s, between attempts to connect
_LARGEST_PAYLOAD: Final = LARGEST_IMAGE + 2**20  # bytes of a websocket message, beyond which the connection is closed


class RosbridgeConnection(Connection):
    """A connection to a rosbridge server; it is opened by ``open`` and kept open until ``close``.

    Parameters
    ----------
    host, port
        Of the server.
    report
        Takes a line when the connection opens or is lost, and for each message that is not valid.

    Raises
    ------
    InputError
        roslibpy is not installed.
    """

    def __init__(self, host: str, port: int, report: Report) -> None:
        try:
            import roslibpy
        except ImportError:
            raise missing_library("rosbridge", "roslibpy") from None
        self._roslibpy = roslibpy
        self._address = host, port
        super().__init__(f"rosbridge {host}:{port}")
        self._report = report
        self._receivers: dict[str, tuple[Receive, int]] = {}
        self._announcements: list[dict[str, Any]] = []
        self._ready = Event()
        self._topics: dict[str, str] = {}
        self._has_topics = Event()
        self._protocol: Any = None
        self._ros: Any = None
        self._flow = _Flow()

    @property
    def connected(self) -> bool:
        """Whether there is a connection now."""
        return self._ready.is_set()

    def open(self, timeout: float) -> bool:
        """Start to connect; returns whether there is a connection after ``timeout`` s. Attempts go on if not."""
        for name in ("roslibpy", "twisted"):  # what they would log is reported here
            logging.getLogger(name).addHandler(logging.NullHandler())
            logging.getLogger(name).propagate = False
        host, port = self._address
        self._ros = self._roslibpy.Ros(host, port)
        factory = self._ros.factory
        factory.maxDelay = _LONGEST_WAIT
        factory.setProtocolOptions(maxMessagePayloadSize=_LARGEST_PAYLOAD)
        self._ros.call_later(0, partial(self._await_connections, factory))
        factory.manager.run()
        if self._ready.wait(timeout):
            return True
        self._report(f"{self.name}: no connection yet; trying again")
        return False

    def close(self) -> None:
        """Close the connection."""
        ros, self._ros = self._ros, None
        self._ready.clear()
        if ros is not None:
            ros.call_later(0, ros.factory.stopTrying)
            ros.close()

    def subscribe(
        self, topic: str, kind: str, receive: Receive, *, largest: int = LARGEST_MESSAGE, newest: bool = False
    ) -> None:
        """Subscribe, now or when the connection opens; as in `Connection`."""
        self._receivers[topic] = receive, largest
        self._announce({"op": "subscribe", "topic": topic, "type": kind, "queue_length": 1 if newest else 0})

    def advertise(self, topic: str, kind: str) -> None:
        """Advertise, now or when the connection opens."""
        self._announce({"op": "advertise", "topic": topic, "type": kind})

    def publish(self, topic: str, fields: Mapping[str, Any]) -> bool:
        """Send a message unless there is no connection or the server does not take what was sent before."""
        if not self._ready.is_set() or self._flow.stopped:
            return False
        self._send({"op": "publish", "topic": topic, "msg": dict(fields)})
        return True

    def topics(self, timeout: float) -> Mapping[str, str] | None:
        """Ask the server's node rosapi for all topics; as in `Connection`, and none where it does not answer."""
        if not self._ready.is_set():
            return None
        self._has_topics.clear()
        self._send({"op": "call_service", "service": "/rosapi/topics", "args": {}})
        return self._topics if self._has_topics.wait(timeout) else {}

    def _announce(self, message: dict[str, Any]) -> None:
        self._announcements.append(message)
        if self._ready.is_set():
            self._send(message)

    def _send(self, message: dict[str, Any]) -> None:
        protocol = self._protocol
        if protocol is not None:
            protocol.send_ros_message(self._roslibpy.Message(message))

    def _await_connections(self, factory: Any) -> None:
        """Receive the events of connections; runs on the thread of the connections.

        If that thread runs already, for an earlier connection of this process, it may have opened this one by now, and
        the event of that is over; ``on_ready`` calls at once then.
        """
        factory.on("close", self._on_close)
        factory.on("ready", self._on_ready)
        factory.on_ready(partial(self._on_ready))  # another object, since it is removed once called

    def _on_ready(self, protocol: Any) -> None:
        if protocol is self._protocol:
            return
        self._flow.stopped = False
        protocol.registerProducer(self._flow, True)
        protocol.on_message = self._on_payload
        self._protocol = protocol
        for message in self._announcements:
            self._send(message)
        self._ready.set()
        self._report(f"{self.name}: connected")

    def _on_close(self, _protocol: Any) -> None:
        self._protocol = None
        if self._ready.is_set():
            self._ready.clear()
            self._report(f"{self.name}: connection lost; trying again")

    def _on_payload(self, payload: bytes) -> None:
        """Hand a message to the receiver of its topic; one that cannot be read costs a line."""
        try:
            self._on_message(payload)
        except Exception as error:
            self._report(f"{self.name}: a message that cannot be read: {one_line(error)}")

    def _on_message(self, payload: bytes) -> None:
        message = json.loads(payload)  # which may have NaN, unlike JSON
        kind = message["op"]
        if kind == "status":
            if message.get("level") in ("error", "warning"):
                self._report(f"{self.name}: {' '.join(str(message.get('msg')).split())[:200]}")
        elif kind == "service_response":
            values = message.get("values") or {}
            self._topics = dict(zip(values.get("topics", ()), values.get("types", ()), strict=False))
            self._has_topics.set()
        elif kind != "publish":
            raise ValueError(f"expected the operation publish or status, got {str(kind)[:50]!r}")
        elif (found := self._receivers.get(message["topic"])) is not None:
            receive, largest = found
            if len(payload) > largest:
                self._report(too_large(message["topic"], len(payload), largest))
            else:
                receive(message["msg"])


class _Flow:
    """Called by the websocket's buffer where sending is to stop, and where it may go on."""

    def __init__(self) -> None:
        self.stopped = False

    def pauseProducing(self) -> None:  # noqa: N802 (Twisted's name)
        self.stopped = True

    def resumeProducing(self) -> None:  # noqa: N802
        self.stopped = False

    stopProducing = pauseProducing  # noqa: N815
