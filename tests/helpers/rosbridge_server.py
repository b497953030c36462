"""A websocket server on 127.0.0.1 that speaks the part of rosbridge's protocol that a client of topics needs."""

from __future__ import annotations

import asyncio
import json
import threading
import time as clock
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application
from tornado.websocket import WebSocketClosedError, WebSocketHandler


class RosbridgeServer:
    """Serves on a port until ``stop``; may be started again on the same port.

    ``received`` has the messages of each topic that clients published, each with the time of its receipt, s. ``topics``
    are those that the service rosapi/topics tells, with their types.
    """

    def __init__(self) -> None:
        self.port = 0
        self.received: dict[str, list[tuple[float, dict[str, Any]]]] = {}
        self.advertised: dict[str, str] = {}
        self.subscribed: dict[str, dict[str, Any]] = {}
        self.refused: list[str] = []
        self.topics: dict[str, str] = {}
        self._clients: set[_Client] = set()

    def start(self) -> None:
        """Serve on another thread."""
        started = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(started)), daemon=True)
        self._thread.start()
        assert started.wait(60)

    def stop(self) -> None:
        """Close all connections and the port."""
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(60)
        assert not self._thread.is_alive()

    def send(self, topic: str, message: dict[str, Any]) -> None:
        """Send a message to the clients that have subscribed to its topic."""
        if topic in self.subscribed:
            self.send_text(json.dumps({"op": "publish", "topic": topic, "msg": message}))

    def send_text(self, text: str) -> None:
        """Send a text as it is to all clients."""
        self._loop.call_soon_threadsafe(self._write, text)

    def _write(self, text: str) -> None:
        for client in list(self._clients):
            try:
                client.write_message(text)
            except WebSocketClosedError:
                self._clients.discard(client)

    async def _serve(self, started: threading.Event) -> None:
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        self.subscribed.clear()
        self.advertised.clear()
        server = HTTPServer(Application([("/", _Client, {"server": self})], websocket_max_message_size=10**8))
        sockets = bind_sockets(self.port, "127.0.0.1")
        self.port = sockets[0].getsockname()[1]
        server.add_sockets(sockets)
        started.set()
        await self._ended.wait()
        server.stop()
        for client in list(self._clients):
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
            self.received.setdefault(topic, []).append((clock.perf_counter(), message["msg"]))
        else:
            self.refused.append(text)


class _Client(WebSocketHandler):
    def initialize(self, server: RosbridgeServer) -> None:
        self._server = server

    def check_origin(self, origin: str) -> bool:
        return True

    def open(self, *args: str, **kwargs: str) -> None:
        self.set_nodelay(True)  # as rosbridge_server does: else the end of a message waits some 40 ms
        self._server._clients.add(self)

    def on_close(self) -> None:
        self._server._clients.discard(self)

    def on_message(self, message: str | bytes) -> None:
        self._server.take(message if isinstance(message, str) else message.decode())

    def data_received(self, chunk: bytes) -> None:
        raise NotImplementedError
