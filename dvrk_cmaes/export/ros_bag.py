"""Writer of ROS recordings with the library rosbags: a .bag file of ROS 1, or a folder (sqlite3) of ROS 2."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from dvrk_cmaes.errors import missing_library
from dvrk_cmaes.export.ros_messages import TF_MESSAGE, RosMessage

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

BagKind = Literal["ros1-bag", "ros2-bag"]

_ROS2_VERSION: Final = 8  # of metadata.yaml; ROS 2 Humble reads it too, unlike 9
_ARRAYS: Final = {"position", "velocity", "effort", "covariance"}  # number sequences of the types in use
_TF_DEFINITION: Final = "geometry_msgs/TransformStamped[] transforms"  # not among rosbags' types of ROS 1


def bag_files(messages: Sequence[RosMessage], kind: BagKind, name: str) -> dict[str, bytes]:
    """Return the files of a recording, by path: ``NAME.bag``, or ``NAME/metadata.yaml`` and ``NAME/NAME.db3``.

    Messages are recorded in their order, at the times in their headers.

    Raises
    ------
    InputError
        rosbags is not installed.
    """
    try:
        import rosbags  # noqa: F401
    except ImportError:
        raise missing_library(f"--to {kind}", "rosbags") from None
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        if kind == "ros1-bag":
            _write_ros1(root / f"{name}.bag", messages)
        else:
            _write_ros2(root / name, messages)
        return {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def _write_ros1(path: Path, messages: Sequence[RosMessage]) -> None:
    """Write a .bag file of ROS 1."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(_TF_DEFINITION, TF_MESSAGE))
    with Writer(path) as writer:
        _record(writer, store, store.serialize_ros1, messages)


def _write_ros2(path: Path, messages: Sequence[RosMessage]) -> None:
    """Write a folder of ROS 2."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(path, version=_ROS2_VERSION, storage_plugin=StoragePlugin.SQLITE3) as writer:
        _record(writer, store, store.serialize_cdr, messages)


def _record(
    writer: Any, store: Typestore, serialize: Callable[[Any, str], Any], messages: Sequence[RosMessage]
) -> None:
    """Write messages to an open recording."""
    connections: dict[str, Any] = {}
    for message in messages:
        if message.topic not in connections:
            connections[message.topic] = writer.add_connection(message.topic, message.kind, typestore=store)
        writer.write(
            connections[message.topic],
            message.time,
            serialize(_built(store, message.kind, message.fields), message.kind),
        )


def _built(store: Typestore, kind: str, fields: dict[str, Any]) -> Any:
    """Build the message object of a type from plain values; a header of ROS 1 gets the sequence number 0."""
    values: dict[str, Any] = {}
    described: Any  # the name of a message type, or for a sequence a pair: ((kind of node, name), length)
    for name, (_, described) in store.fielddefs[kind][1]:
        value = fields.get(name, 0)
        if isinstance(value, dict):
            value = _built(store, described, value)
        elif isinstance(value, list) and any(isinstance(element, dict) for element in value):
            value = [_built(store, described[0][1], element) for element in value]
        elif name in _ARRAYS:
            value = np.array(value, dtype=np.float64)
        values[name] = value
    return store.types[kind](**values)
