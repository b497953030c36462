"""Reader of ROS recordings with the library rosbags: .bag files of ROS 1, folders (sqlite3 or MCAP) of ROS 2."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.io.yaml_file import check_yaml
from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.recording.camera import camera_file, read_camera_bytes
from dvrk_cmaes.recording.messages import image_file, joint_names, joint_values, stamp
from dvrk_cmaes.recording.pose_table import PoseTable
from dvrk_cmaes.recording.reading_table import read_timed_joints
from dvrk_cmaes.recording.recording import RecordedImage, Recording
from dvrk_cmaes.recording.topics import TopicRequest, Topics, choose_topics

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_LONGEST_QOS = 100_000  # characters of a value in metadata.yaml, which may hold the QoS of many publishers
_LARGEST_MESSAGE, _LARGEST_IMAGE = 2**20, 400_000_000  # bytes

SUFFIXES = (".bag", ".mcap", ".db3")
"""Suffixes of ROS recordings; a recording may also be a folder."""


@contextmanager
def open_bag(
    path: Path,
    requested: TopicRequest,
    *,
    recorded_times: bool = False,
    camera: Path | None = None,
    joints: Path | PoseTable | None = None,
    side: Side | None = None,
) -> Iterator[Recording]:
    """Open a ROS recording; readings and camera are read at once, images during iteration.

    Parameters
    ----------
    path
        A .bag, .mcap or .db3 file, or a folder with metadata.yaml.
    requested
        Topics given by name; the others are found automatically.
    recorded_times
        Use the times at which messages were recorded instead of those in their headers. This is also done, with a note,
        if the headers of a topic have no times.
    camera, joints
        A camera file, and a file of time-stamped readings, to use instead of the recording's topics.
    side
        The eye of a stereo endoscope, which is a word in the name of its images' topic; None for one camera.

    Raises
    ------
    InputError
        rosbags is not installed, the recording is damaged, a topic is missing or ambiguous, or a message is not valid.
    """
    with _open(path) as reader:
        with _errors_as_input_errors(path):
            recording = _recording(reader, path, requested, recorded_times, camera, joints, side)
        yield recording  # outside the inner context: errors of the caller are not damage of the recording


def _recording(
    reader: AnyReader,
    path: Path,
    requested: TopicRequest,
    recorded_times: bool,
    camera: Path | None,
    joints: Path | PoseTable | None,
    side: Side | None,
) -> Recording:
    """Choose topics and time source, read camera and readings; the recording's ``notes`` state the choices."""
    types = {connection.topic: connection.msgtype for connection in reader.connections if connection.msgcount}
    topics = choose_topics(path, types, requested, camera=camera is None, joints=joints is None, side=side)
    used = [name for name in (topics.joints, topics.jaw) if name is not None]
    notes = [f"images: {topics.image}"]
    if "_rect" in topics.image:
        notes.append(f"{topics.image}: by their name these images are rectified: then say --rectified to estimate")
    lens, changes = _camera(reader, path, topics) if camera is None else (read_camera_bytes(camera), "")
    notes.append(f"camera: {camera or topics.camera}{changes}")
    without = [name for name in (topics.image, *used) if stamp(_first(reader, path, name)) == 0]
    if without and not recorded_times:
        notes.append(f"times: those of recording, for headers on {', '.join(without)} have none")
    else:
        notes.append(f"times: {'those of recording' if recorded_times else 'those of the headers'}")
    by_recording = recorded_times or bool(without)
    readings = [_readings(reader, path, name, by_recording) for name in used]
    if joints is not None:
        readings += read_timed_joints(joints)
    notes += [f"{' '.join(series.joints)}: {series.source}" for series in readings]
    unnamed = [name for name in used if not _first(reader, path, name).name]
    if unnamed:
        notes.append(f"{', '.join(unnamed)}: joints are not named: taken in the dVRK's order, by their number")
    if topics.joints is not None and topics.jaw is None:
        notes.append("jaw: not read")
    total = sum(connection.msgcount for connection in reader.connections if connection.topic == topics.image)
    return Recording(
        path, _images(reader, path, topics.image, by_recording), total, lens, tuple(readings), tuple(notes)
    )


@contextmanager
def _open(path: Path) -> Iterator[AnyReader]:
    """Open a recording with rosbags; InputError if it is not one or rosbags is not installed."""
    if not path.is_dir():
        check_file(path, expected="a ROS recording")
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(
            f"{path}: ROS recordings are read by the library rosbags, which is not installed; "
            "run: pip install 'rosbags>=0.11,<0.12'"
        ) from None
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise InputError(
            f"{path}: expected a ROS 2 recording, got a folder without metadata.yaml "
            "(give its .mcap or .db3 file, or run: ros2 bag reindex)"
        )
    if path.is_dir():
        check_yaml(path / "metadata.yaml", expected="metadata of a ROS 2 recording", longest=_LONGEST_QOS)
    with _errors_as_input_errors(path):
        # recordings of ROS 2 before Iron lack message definitions; those of sensor_msgs are unchanged since
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


@contextmanager
def _errors_as_input_errors(path: Path) -> Iterator[None]:
    """Convert every exception of the parsers, e.g. AssertionError or MemoryError, to InputError."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = "it claims more than fits into memory" if isinstance(error, MemoryError) else one_line(error)
        raise InputError(f"{path}: expected a ROS recording, got one that cannot be read: {reason}") from None


def _messages(reader: AnyReader, path: Path, topic: str) -> Iterator[tuple[int, Any]]:
    """Yield the messages of a topic in the order of the recording, each with its recording time, ns.

    InputError for one that is too large, before it is parsed.
    """
    connections = [connection for connection in reader.connections if connection.topic == topic]
    largest = _LARGEST_IMAGE if any("Image" in connection.msgtype for connection in connections) else _LARGEST_MESSAGE
    for connection, time, data in reader.messages(connections):
        if len(data) > largest:
            raise InputError(f"{path}: {topic}: expected messages of at most {largest} bytes, got one of {len(data)}")
        yield time, reader.deserialize(data, connection.msgtype)


def _first(reader: AnyReader, path: Path, topic: str) -> Any:
    """Return the first message of a topic; InputError if there is none."""
    for _, message in _messages(reader, path, topic):
        return message
    raise InputError(f"{path}: {listed([topic])}: expected messages, got none, though the recording lists some")


def _camera(reader: AnyReader, path: Path, topics: Topics) -> tuple[bytes, str]:
    """Return the camera file of the first CameraInfo message, and a note if later messages differ."""
    assert topics.camera is not None
    name = topics.image.strip("/").replace("/", "_")
    first: bytes | None = None
    others = 0
    for _, message in _messages(reader, path, topics.camera):
        file = camera_file(message, name)
        others += first not in (None, file)
        first = file if first is None else first
    if first is None:
        raise InputError(f"{path}: {topics.camera}: expected a message, got none")
    return first, f" (the first: {others} later messages differ from it)" if others else ""


def _readings(reader: AnyReader, path: Path, topic: str, recorded_times: bool) -> TimedReadings:
    """Read all readings of a topic as a time series."""
    where = f"{path}: {topic}"
    names: tuple[str, ...] | None = None
    times: list[int] = []
    rows: list[list[float]] = []
    for time, message in _messages(reader, path, topic):
        names = names or joint_names(message, where)
        rows.append(joint_values(message, names, where))
        times.append(time if recorded_times else stamp(message))
    return TimedReadings.of(topic, names or (), times, rows)


def _images(reader: AnyReader, path: Path, topic: str, recorded_times: bool) -> Iterator[RecordedImage]:
    """Yield the images of a topic; an image is decoded and encoded only when it is loaded."""
    with _errors_as_input_errors(path):
        for number, (time, message) in enumerate(_messages(reader, path, topic)):
            where = f"{path}: {topic}: image {number}"
            yield RecordedImage(
                number,
                time if recorded_times else stamp(message),
                lambda message=message, where=where: image_file(message, where),  # type: ignore[misc]
            )
