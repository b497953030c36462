"""Connection to ROS over a websocket, to a rosbridge server, with the library roslibpy.

The connection is opened again whenever it is lost. Messages are published only while it is open and the server takes
them; they are never queued, so that memory does not grow and what arrives is new.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import partial
from threading import Event
from typing import Any, Final

from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.live.connection import Receive, Report

_LONGEST_WAIT: Final = 2.0  # s, between attempts to connect


class RosbridgeConnection:
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
            raise InputError(
                "rosbridge: the library roslibpy, which connects to it, is not installed; "
                "run: pip install 'dvrk-cmaes[ros]'"
            ) from None
        self._roslibpy = roslibpy
        self._address = host, port
        self._name = f"rosbridge {host}:{port}"
        self._report = report
        self._receivers: dict[str, Receive] = {}
        self._announcements: list[dict[str, Any]] = []
        self._ready = Event()
        self._protocol: Any = None
        self._ros: Any = None
        self._flow = _Flow()
        self._log = _LogReports(self._name, report)

    def open(self, timeout: float) -> bool:
        """Start to connect; returns whether there is a connection after ``timeout`` s. Attempts go on if not."""
        self._log.start()
        host, port = self._address
        self._ros = self._roslibpy.Ros(host, port)
        factory = self._ros.factory
        factory.maxDelay = _LONGEST_WAIT
        for topic, receive in self._receivers.items():
            factory.on(topic, receive)
        self._ros.call_later(0, partial(self._await_connections, factory))
        factory.manager.run()
        if self._ready.wait(timeout):
            return True
        self._report(f"{self._name}: no connection yet; trying again")
        return False

    def close(self) -> None:
        """Close the connection."""
        ros, self._ros = self._ros, None
        self._ready.clear()
        if ros is not None:
            ros.call_later(0, ros.factory.stopTrying)
            ros.close()
        self._log.stop()

    def subscribe(self, topic: str, kind: str, receive: Receive, *, newest: bool = False) -> None:
        """Subscribe, now or when the connection opens; as in `Connection`."""
        self._receivers[topic] = receive
        if self._ros is not None:
            self._ros.factory.on(topic, receive)
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
        # roslibpy knows the operation and has no handler for it
        protocol._message_handlers["status"] = self._on_status
        self._protocol = protocol
        for message in self._announcements:
            self._send(message)
        self._ready.set()
        self._report(f"{self._name}: connected")

    def _on_close(self, _protocol: Any) -> None:
        self._protocol = None
        if self._ready.is_set():
            self._ready.clear()
            self._report(f"{self._name}: connection lost; trying again")

    def _on_status(self, message: Mapping[str, Any]) -> None:
        if message.get("level") in ("error", "warning"):
            self._report(f"{self._name}: {' '.join(str(message.get('msg')).split())[:200]}")


class _Flow:
    """Is told by the websocket's buffer when to stop sending, and when to go on."""

    def __init__(self) -> None:
        self.stopped = False

    def pauseProducing(self) -> None:  # noqa: N802 (Twisted's name)
        self.stopped = True

    def resumeProducing(self) -> None:  # noqa: N802
        self.stopped = False

    def stopProducing(self) -> None:  # noqa: N802
        self.stopped = True


class _LogReports(logging.Handler):
    """Turns log messages of exceptions in roslibpy, e.g. for a message that is not JSON, into lines for the user."""

    def __init__(self, name: str, report: Report) -> None:
        super().__init__(logging.ERROR)
        self._source = name
        self._line = report

    def emit(self, record: logging.LogRecord) -> None:
        """Report an error in one line."""
        error = record.exc_info[1] if record.exc_info else None
        if type(error).__name__ == "Disconnected":
            return  # a message was on its way when the connection closed, which is reported by itself
        reason = record.getMessage() if error is None else one_line(error)
        self._line(f"{self._source}: a message that cannot be read: {reason}")

    def start(self) -> None:
        """Receive the errors."""
        for name in ("roslibpy", "twisted"):
            logging.getLogger(name).addHandler(self)
            logging.getLogger(name).propagate = False

    def stop(self) -> None:
        """Receive them no longer."""
        for name in ("roslibpy", "twisted"):
            logging.getLogger(name).removeHandler(self)
            logging.getLogger(name).propagate = True
