"""Small ROS 1 and ROS 2 recordings and videos, written by rosbags and OpenCV, for the tests of import."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

KINDS = ("ros1", "sqlite3", "mcap")
SECOND = 1_000_000_000
BEGIN = 1_795_000_000 * SECOND + 123_456_789
"""Time of the first image, ns since 1970."""

WIDTH, HEIGHT = 64, 48
ARM = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")


@dataclass(frozen=True, eq=False)
class Message:
    """A message to record: topic, type without the package, time of recording in ns, fields besides the header."""

    topic: str
    kind: str
    time: int
    fields: dict[str, Any] = field(default_factory=dict)
    stamp: int | None = None
    """Time in the header, ns; that of recording unless given."""


def pixels(number: int, channels: int = 3) -> np.ndarray:
    """Give an image (48, 64, channels) that is different for every number."""
    return np.random.default_rng(number).integers(0, 256, (HEIGHT, WIDTH, channels), np.uint8)


def image(time: int, data: np.ndarray, encoding: str = "bgr8", topic: str = "/left/image_raw", pad: int = 0) -> Message:
    """Give an Image message of pixels (H, W, C), with rows padded by ``pad`` bytes."""
    rows = np.pad(data.reshape(len(data), -1), ((0, 0), (0, pad)))
    fields = {
        "height": data.shape[0],
        "width": data.shape[1],
        "encoding": encoding,
        "is_bigendian": 0,
        "step": rows.shape[1],
        "data": rows.reshape(-1),
    }
    return Message(topic, "Image", time, fields)


def compressed(time: int, data: bytes, form: str = "jpeg", topic: str = "/left/image_raw/compressed") -> Message:
    return Message(topic, "CompressedImage", time, {"format": form, "data": np.frombuffer(data, np.uint8)})


def joints(
    time: int, positions: Sequence[float], names: Sequence[str] = ARM, topic: str = "/PSM1/measured_js"
) -> Message:
    empty = np.zeros(0)
    fields = {"name": list(names), "position": np.array(positions, float), "velocity": empty, "effort": empty}
    return Message(topic, "JointState", time, fields)


def jaw(time: int, position: float, topic: str = "/PSM1/jaw/measured_js") -> Message:
    return joints(time, [position], ["jaw"], topic)


def camera_info(time: int, topic: str = "/left/camera_info", **changes: Any) -> Message:
    fields = {
        "height": HEIGHT,
        "width": WIDTH,
        "distortion_model": "plumb_bob",
        "d": np.array([-0.21, 0.1, 1e-05, -2e-05, 0.0]),
        "k": np.array([80.25, 0, 31.5, 0, 81.75, 22.125, 0, 0, 1]),
        "r": np.eye(3).reshape(-1),
        "p": np.array([78.0, 0, 30.0, 0, 0, 78.0, 23.0, 0, 0, 0, 1, 0]),
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }
    return Message(topic, "CameraInfo", time, {**fields, **changes})


def sweep(time: int) -> list[float]:
    """Give readings of an arm that are linear in time, so that interpolation is exact."""
    s = (time - BEGIN) / SECOND
    return [0.1 + s, 0.2 - s, 0.1 + 0.01 * s, 0.3 * s, -0.5 + 0.7 * s, 0.4 - 0.2 * s]


def good(images: int = 5, rate: float = 10.0) -> list[Message]:
    """Give the messages of a recording of images, and of readings at 50 Hz between them."""
    times = [BEGIN + round(k * SECOND / rate) for k in range(images)]
    ticks = range(BEGIN - 27_000_000, times[-1] + 40_000_000, 20_000_000)
    return [
        camera_info(BEGIN - 5),
        *(image(time, pixels(k)) for k, time in enumerate(times)),
        *(joints(tick, sweep(tick)) for tick in ticks),
        *(jaw(tick + 3_000_000, 0.25 * (tick - BEGIN) / SECOND) for tick in ticks),
    ]


def stamped(messages: Iterable[Message], stamp: int) -> list[Message]:
    """Give the messages with another time in their headers."""
    return [replace(message, stamp=stamp) for message in messages]


_typestore = cache(get_typestore)
"""The message types of a ROS release, whose code is generated once."""


def write_bag(path: Path, kind: str, messages: Iterable[Message]) -> Path:
    """Record messages in the order of their times; gives the path with the kind's suffix."""
    ordered = sorted(messages, key=lambda message: message.time)
    if kind == "ros1":
        path = path.with_suffix(".bag")
        store = _typestore(Stores.ROS1_NOETIC)
        with Writer1(path) as writer1:
            connections = {}
            for m in ordered:
                if m.topic not in connections:
                    name = _type(m)
                    connections[m.topic] = writer1.add_connection(m.topic, name, typestore=store)
                data = store.serialize_ros1(_message(store, m, ros1=True), _type(m))
                writer1.write(connections[m.topic], m.time, data)
        return path
    store = _typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer2(path, version=9, storage_plugin=plugin) as writer2:
        topics = {}
        for m in ordered:
            name = _type(m)
            if m.topic not in topics:
                topics[m.topic] = writer2.add_connection(m.topic, name, typestore=store)
            writer2.write(topics[m.topic], m.time, store.serialize_cdr(_message(store, m, ros1=False), name))
    return path


def _type(m: Message) -> str:
    return f"{'geometry' if m.kind == 'PoseStamped' else 'sensor'}_msgs/msg/{m.kind}"


def _message(store: Any, m: Message, *, ros1: bool) -> Any:
    types = store.types
    when = m.time if m.stamp is None else m.stamp
    time = types["builtin_interfaces/msg/Time"](sec=when // SECOND, nanosec=when % SECOND)
    header = {"stamp": time, "frame_id": "left"}
    if ros1:
        header["seq"] = 0
    fields = dict(m.fields)
    if m.kind == "PoseStamped":
        x, y, z, *turn = fields["pose"]
        point = types["geometry_msgs/msg/Point"](x=x, y=y, z=z)
        quaternion = types["geometry_msgs/msg/Quaternion"](**dict(zip("xyzw", turn, strict=True)))
        fields["pose"] = types["geometry_msgs/msg/Pose"](position=point, orientation=quaternion)
    if m.kind == "CameraInfo":
        fields["roi"] = types["sensor_msgs/msg/RegionOfInterest"](**fields["roi"])
        if ros1:
            fields = {key.upper() if key in "dkrp" else key: value for key, value in fields.items()}
    return types[_type(m)](header=types["std_msgs/msg/Header"](**header), **fields)


def write_video(path: Path, frames: int = 10, rate: float = 25.0, code: str = "FFV1") -> Path:
    """Write a video of ``pixels``; FFV1 loses nothing."""
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*code), rate, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for k in range(frames):
        writer.write(pixels(k))
    writer.release()
    return path


def write_lerobot(folder: Path, readings: Sequence[Sequence[float]], episode: int = 0) -> Path:
    """Write a LeRobot data set, v2.1, of one episode, with the readings (N, 7) of PSM1 at 25 Hz and a video."""
    key, rows = "observation.images.left", range(len(readings))
    features = {"observation.state": {"names": [f"PSM1.{name}" for name in (*ARM, "jaw")]}, key: {"dtype": "video"}}
    info = {"codebase_version": "v2.1", "fps": 25, "features": features}
    info["data_path"] = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    info["video_path"] = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
    for part in ("meta", "data/chunk-000", f"videos/chunk-000/{key}"):
        (folder / part).mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    columns: dict[str, Any] = {"episode_index": [episode] * len(rows), "frame_index": list(rows)}
    columns |= {"timestamp": [k / 25 for k in rows], "observation.state": [list(row) for row in readings]}
    pq.write_table(pa.table(columns), folder / "data" / "chunk-000" / f"episode_{episode:06d}.parquet")
    write_video(folder / "videos" / "chunk-000" / key / f"episode_{episode:06d}.mp4", code="mp4v")
    return folder
