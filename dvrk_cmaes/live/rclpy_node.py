"""Connection to ROS 2 as a node of its own, where rclpy is importable, as in a sourced ROS 2 environment."""

from __future__ import annotations

import base64
from array import array
from collections.abc import Mapping
from threading import Event, Thread
from typing import Any, Final

import numpy as np

from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.live.connection import LARGEST_MESSAGE, Connection, Receive, Report, too_large

_NODE: Final = "dvrk_cmaes"
_DEPTH: Final = 100  # of the queue of a topic whose messages all matter


class RclpyConnection(Connection):
    """A node of ROS 2 that is spun on a thread of its own.

    Parameters
    ----------
    report
        Takes a line for each message that cannot be read.

    Raises
    ------
    InputError
        rclpy is not importable.
    """

    def __init__(self, report: Report) -> None:
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.qos import QoSProfile, ReliabilityPolicy
            from rosidl_runtime_py.utilities import get_message
        except ImportError as error:
            raise InputError(
                f"rclpy: not importable ({one_line(error)}); source ROS 2 first, or use a rosbridge server"
            ) from None
        super().__init__("ROS 2")
        self._executor, self._type_of = SingleThreadedExecutor, get_message
        self._profile, self._best_effort = QoSProfile, ReliabilityPolicy.BEST_EFFORT
        self._report = report
        self._context = rclpy.Context()
        self._context.init()
        self._node = rclpy.create_node(_NODE, context=self._context)
        self._publishers: dict[str, tuple[Any, Any]] = {}
        self._closed = Event()
        self._thread = Thread(target=self._spin, daemon=True)

    def open(self, timeout: float) -> bool:
        """Begin to receive messages; a node needs no server."""
        self._thread.start()
        return True

    def close(self) -> None:
        """End the node."""
        self._closed.set()
        self._thread.join()
        self._context.shutdown()
        self._node.destroy_node()

    def subscribe(
        self, topic: str, kind: str, receive: Receive, *, largest: int = LARGEST_MESSAGE, newest: bool = False
    ) -> None:
        """Subscribe, with any publisher's reliability; as in `Connection`."""
        quality = self._profile(depth=1 if newest else _DEPTH, reliability=self._best_effort)

        def convert(message: Any) -> None:
            try:
                if (size := _least_size(message)) > largest:
                    self._report(too_large(topic, size, largest))
                    return
                fields = plain_fields(message)
            except (AttributeError, TypeError, ValueError) as error:
                self._report(f"{topic}: a message that cannot be read: {one_line(error)}")
                return
            receive(fields)

        self._node.create_subscription(self._type_of(_full(kind)), topic, convert, quality)

    def topics(self, timeout: float) -> dict[str, str]:
        """Return the types of the topics that the node has discovered, by name."""
        return {topic: kinds[0] for topic, kinds in self._node.get_topic_names_and_types()}

    def advertise(self, topic: str, kind: str) -> None:
        """Create a publisher, unless there is one."""
        if topic in self._publishers:
            return
        of_kind = self._type_of(_full(kind))
        self._publishers[topic] = self._node.create_publisher(of_kind, topic, 1), of_kind

    def publish(self, topic: str, fields: Mapping[str, Any]) -> bool:
        """Publish a message on a topic that was advertised."""
        publisher, of_kind = self._publishers[topic]
        publisher.publish(filled_message(of_kind(), fields, self._type_of))
        return True

    def _spin(self) -> None:
        """Receive messages until the node is closed: one that waits while its context is shut down raises."""
        executor = self._executor(context=self._context)
        executor.add_node(self._node)
        while not self._closed.is_set():
            executor.spin_once(timeout_sec=0.1)


def _least_size(message: Any) -> int:
    """Return the bytes of a message's longest field at least: one for each element."""
    fields = (getattr(message, name) for name in message.get_fields_and_field_types())
    return max((len(value) for value in fields if hasattr(value, "__len__")), default=0)


def plain_fields(message: Any) -> Any:
    """Return the fields of a message of ROS 2 as plain values; sequences of uint8 as bytes."""
    fields = {}
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            fields[name] = plain_fields(value)
        elif kind == "sequence<uint8>":
            fields[name] = bytes(value)
        elif "/" in kind:  # a sequence of messages
            fields[name] = [plain_fields(element) for element in value]
        elif isinstance(value, str | int | float | bool | bytes):
            fields[name] = value
        else:
            fields[name] = np.asarray(value).tolist()
    return fields


def filled_message(message: Any, fields: Mapping[str, Any], type_of: Any) -> Any:
    """Set fields of a message of ROS 2 from plain values, sequences of uint8 from base64; returns the message."""
    kinds = message.get_fields_and_field_types()
    for name, value in fields.items():
        kind = kinds[name]
        if isinstance(value, Mapping):
            filled_message(getattr(message, name), value, type_of)
            continue
        if kind == "sequence<uint8>":
            value = array("B", base64.b64decode(value))
        elif kind == "octet":
            value = bytes([value])
        elif "/" in kind:
            inner = type_of(_full(kind.removeprefix("sequence<").partition(">")[0]))
            value = [filled_message(inner(), element, type_of) for element in value]
        setattr(message, name, value)
    return message


def _full(kind: str) -> str:
    """Return a type's name as in ROS 2, package/msg/Type."""
    package, _, name = kind.replace("/msg/", "/").partition("/")
    return f"{package}/msg/{name}"
