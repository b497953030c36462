"""The part of rclpy that a node of topics needs, within one process, with message types of ROS 2's definitions."""

from __future__ import annotations

import sys
from array import array
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

_STORE = get_typestore(Stores.ROS2_HUMBLE)
_NAMES = {"float64": "double", "float32": "float", "bool": "boolean", "byte": "octet"}


@cache
def get_message(kind: str) -> type:
    """Make a message class as rosidl does: typed default values, and get_fields_and_field_types."""
    kinds = {name: _kind_name(described) for name, described in _STORE.fielddefs[kind][1]}
    if kind == "diagnostic_msgs/msg/DiagnosticStatus":
        kinds["level"] = "octet"  # rosbags has uint8

    class Message:
        def __init__(self, **fields: Any) -> None:
            for name, one in kinds.items():
                setattr(self, name, fields.get(name, _default(one)))

        def __setattr__(self, name: str, value: Any) -> None:
            assert name in kinds, name
            if kinds[name] == "octet":
                assert isinstance(value, bytes), name
            elif kinds[name] == "double":
                assert isinstance(value, float), name
            object.__setattr__(self, name, value)

        @staticmethod
        def get_fields_and_field_types() -> dict[str, str]:
            return kinds

    return Message


def _kind_name(described: Any) -> str:
    node, inner = described
    if node == Nodetype.BASE:
        return _NAMES.get(inner[0], inner[0])
    if node == Nodetype.NAME:
        return str(inner).replace("/msg/", "/")
    name = _kind_name(inner[0])
    return f"{name}[{inner[1]}]" if node == Nodetype.ARRAY else f"sequence<{name}>"


def _default(kind: str) -> Any:
    if kind.startswith("sequence<"):
        return {"sequence<double>": array("d"), "sequence<uint8>": array("B")}.get(kind, [])
    if kind.endswith("]"):
        return np.zeros(int(kind.partition("[")[2][:-1]))
    if "/" in kind:
        return get_message(kind.replace("/", "/msg/"))()
    return {"string": "", "double": 0.0, "float": 0.0, "boolean": False, "octet": b"\0"}.get(kind, 0)


class Bus:
    """All topics of the process: receivers and published messages by topic."""

    def __init__(self) -> None:
        self.receivers: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self.published: dict[str, list[Any]] = {}
        self.open = False

    def install(self, patch: pytest.MonkeyPatch) -> None:
        """Let rclpy be imported."""
        bus = self

        class Context:
            def init(self) -> None:
                bus.open = True

            def shutdown(self) -> None:
                bus.open = False

            def ok(self) -> bool:
                return bus.open

        class Publisher:
            def __init__(self, kind: type, topic: str) -> None:
                self.kind, self.topic = kind, topic

            def publish(self, message: Any) -> None:
                assert isinstance(message, self.kind)
                bus.published.setdefault(self.topic, []).append(message)

        class Node:
            def create_subscription(self, kind: type, topic: str, receive: Any, quality: Any) -> None:
                bus.receivers[topic] = kind, receive

            def create_publisher(self, kind: type, topic: str, depth: int) -> Publisher:
                return Publisher(kind, topic)

            def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
                return [("/left/image", ["sensor_msgs/msg/Image"]), ("/tf", ["tf2_msgs/msg/TFMessage"])]

            def destroy_node(self) -> None:
                assert not bus.open

        class Executor:
            def __init__(self, context: Context) -> None: ...

            def add_node(self, node: Node) -> None: ...

            def spin_once(self, timeout_sec: float) -> None:
                import time

                time.sleep(0.01)
                assert bus.open  # rclpy raises where a context is shut down meanwhile

        contents: dict[str, dict[str, Any]] = {
            "rclpy": {
                "Context": Context,
                "create_node": lambda name, context=None: Node(),
                "init": lambda: None,
                "spin": lambda node: None,
            },
            "rclpy.executors": {"SingleThreadedExecutor": Executor},
            "rclpy.qos": {
                "QoSProfile": dict,
                "ReliabilityPolicy": type("Policy", (), {"BEST_EFFORT": 2}),
                "qos_profile_sensor_data": {},
            },
            "rosidl_runtime_py": {},
            "rosidl_runtime_py.utilities": {"get_message": get_message},
        }
        for name, members in contents.items():
            module = ModuleType(name)
            vars(module).update(members)
            patch.setitem(sys.modules, name, module)
