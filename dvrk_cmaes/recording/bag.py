"""Reader of ROS recordings with the library rosbags: .bag files of ROS 1, folders (sqlite3 or MCAP) of ROS 2."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvrk_cmaes.errors import InputError, missing_library, one_line
from dvrk_cmaes.instrument.setup_joints import SETUP, setup_text
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.io.yaml_file import check_yaml
from dvrk_cmaes.joints.interpolation import NANOSECONDS, TimedReadings
from dvrk_cmaes.joints.names import ECM_JOINTS, notes_on_messages
from dvrk_cmaes.joints.rows import JointFile, JointRow
from dvrk_cmaes.recording.camera import camera_file, read_camera_bytes
from dvrk_cmaes.recording.messages import ecm_values, image_file, joint_values, stamp, stamped_pose
from dvrk_cmaes.recording.recording import Asked, RecordedImage, Recording
from dvrk_cmaes.recording.topics import (
    IMAGES,
    NONE,
    SUFFIXES_2,
    choose_camera,
    choose_image,
    choose_joints,
    ecm_topic,
    setup_topics,
)

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_LONGEST_QOS = 100_000  # characters of a value in metadata.yaml, which may hold the QoS of many publishers
_JUDGED = 50  # messages of images whose times show whether a clock sets them
_BLANK_STORAGE = re.compile(r"""^\s*storage_identifier:\s*(?:""|''|~|null)?\s*$""", re.MULTILINE)
_LARGEST_MESSAGE, _LARGEST_IMAGE = 2**20, 400_000_000  # bytes


def open_bag(path: Path, asked: Asked) -> Recording:
    """Open a ROS recording; readings and camera are read at once, images during iteration.

    Topics and the source of times are chosen here; the recording's ``notes`` state the choices.

    Parameters
    ----------
    path
        A .bag, .mcap or .db3 file, or a folder with such files of ROS 2.
    asked
        What is read. Topics that are not given are found automatically. A recording without images needs no camera.

    Raises
    ------
    InputError
        rosbags is not installed, the recording is damaged, a topic is missing or ambiguous, or a message is not valid.
    """
    with _open(path) as reader:
        return _recording(reader, path, asked)


def _recording(reader: AnyReader, path: Path, asked: Asked) -> Recording:
    """Choose topics and time source, and read camera and readings of an open recording."""
    option = "--image-topic"
    if asked.both and asked.side == "right":  # the readings are read with the left eye
        option, topic = "--image-topic-right", asked.image_topic_right
        asked = replace(asked, arms=(), joints=None, image_topic=topic, camera_topic=None, joints_topic=NONE)
    camera = asked.camera
    types = {connection.topic: connection.msgtype for connection in reader.connections if connection.msgcount}
    has_images = asked.image_topic is not None or any(kind in IMAGES for kind in types.values())
    image = choose_image(path, types, asked, asked.side, option) if has_images else None
    info = choose_camera(path, types, asked, image) if image is not None and camera is None else None
    chosen = {
        arm: choose_joints(path, types, asked, arm or None) if asked.joints is None else []
        for arm in asked.arms or ("",)
    }
    read = {arm: [_Readings.of(reader, path, name, arm or None) for name in own] for arm, own in chosen.items()}
    if (ecm := ecm_topic(types, next(iter(next(iter(chosen.values()))), None))) is not None:
        of_ecm = _Readings.of(reader, path, ecm, None, of_ecm=True)
        read = {arm: [*own, of_ecm] for arm, own in read.items()}
    stamps = {own.topic: own.stamps for of_arm in read.values() for own in of_arm}
    setup = {
        arm: stamped_pose(message)
        for arm, topic in setup_topics(types).items()
        for _, message in islice(_messages(reader, path, topic), 1)
    }
    notes: list[str] = [f"set-up joints: of {' '.join(setup)}, as {SETUP}"] if setup else []
    lens = b""
    if image is None:
        notes.append("images: none, readings only")
    else:
        notes.append(f"images: {image}")
        if "_rect" in image:
            notes.append(f"{image}: by their name these images are rectified: then say --rectified")
        lens, changes = (b"", "") if info is None else _camera(reader, path, info, image)
        lens = lens if camera is None else read_camera_bytes(camera)
        notes.append(f"camera: {camera or info}{changes}")
        stamps |= {image: [stamp(m) for _, m in islice(_messages(reader, path, image), _JUDGED)]}
    faults = [f"{name} {fault}" for name, each in stamps.items() if (fault := _fault(each))]
    why = f", for the headers on {', and on '.join(faults)}" if faults and not asked.recorded_times else ""
    by_recording = asked.recorded_times or bool(faults)
    notes.append(f"times: those of {'recording' if by_recording else 'the headers'}{why}")
    arms: dict[str, tuple[TimedReadings, ...]] = {}
    for arm, of_arm in read.items():
        given, _ = asked.given_readings(arm or None)
        series = (*(own.series(by_recording) for own in of_arm), *given)
        name = f"{arm}: " if len(read) > 1 else ""
        arms[arm if len(read) > 1 else ""] = series
        notes += [f"{name}{' '.join(own.joints)}: {own.source}" for own in series]
        notes += [f"{own.topic}: {note}" for own in of_arm for note in own.notes]
        if series and not any("jaw" in own.joints for own in series):
            notes.append(f"{name}jaw: not read")
    images = iter(()) if image is None else _images(path, image, by_recording)
    total = sum(connection.msgcount for connection in reader.connections if connection.topic == image)
    kept = {SETUP: setup_text(setup).encode()} if setup else {}
    return Recording(path, images, total, lens, arms, tuple(notes), kept, rectified=asked.rectified)


def read_bag_joints(path: Path, arm: str | None = None) -> JointFile:
    """Read the readings of an arm in a ROS recording as a file of readings with times; errors as `open_bag`."""
    recording = open_bag(path, Asked(arms=() if arm is None else (arm,), image_topic=NONE))
    rows: dict[str, JointRow] = {}
    for series in (series for of_arm in recording.arms.values() for series in of_arm):
        for k, (time, row) in enumerate(zip(series.times.tolist(), series.values.tolist(), strict=True)):
            where, name = f"{path}: {series.source}: message {k + 1}", f"message {k + 1} of {series.source}"
            rows[name] = where, dict(zip(series.joints, row, strict=True)), time
    return JointFile.of(str(path), "ROS recording", rows, "message", recording.notes)


def list_topics(path: Path) -> tuple[float, dict[str, tuple[str, int, float]]]:
    """Return the duration of a ROS recording, s, and by topic its type, the number of messages, and these by second.

    Errors are as of `open_bag`.
    """
    with _open(path) as reader:
        seconds = max(reader.end_time - reader.start_time, 0) / NANOSECONDS
        counts: Counter[tuple[str, str]] = Counter()
        for connection in reader.connections:
            counts[connection.topic, connection.msgtype.replace("/msg/", "/")] += connection.msgcount
        topics = {
            name: (kind, count, (count - 1) / seconds if count > 1 and seconds else 0.0)
            for (name, kind), count in sorted(counts.items())
        }
    return seconds, topics


def _fault(stamps: Sequence[int]) -> str:
    """Return what is wrong with the times in the headers of a topic; empty if they are those of a clock."""
    if not any(stamps):
        return "have none"
    repeated = len(stamps) - len(set(stamps))
    return f"do not advance ({repeated} of {len(stamps)} have an earlier one's)" if 2 * repeated >= len(stamps) else ""


@contextmanager
def _open(path: Path) -> Iterator[AnyReader]:
    """Open a recording with rosbags; every error of its parsers becomes an InputError."""
    if not path.is_dir():
        check_file(path, expected="a ROS recording")
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise missing_library(f"{path}: a ROS recording", "rosbags") from None
    files = _files(path)
    try:
        # recordings of ROS 2 before Iron lack message definitions; those of sensor_msgs are unchanged since
        with AnyReader(files, default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except InputError:
        raise
    except Exception as error:  # of many types, e.g. AssertionError or MemoryError
        reason = "it claims more than fits into memory" if isinstance(error, MemoryError) else one_line(error)
        raise InputError(
            f"{path}: expected a ROS recording, got one that cannot be read: {reason}; one that was cut off "
            "is mended by rosbag reindex (.bag), mcap recover (.mcap), or ros2 bag reindex (a folder)"
        ) from None


def _files(path: Path) -> list[Path]:
    """Return what is opened: the path, or the files of a folder without metadata that name the storage.

    ``ros2 bag reindex`` of ROS 2 Humble leaves the storage's name blank.
    """
    if not path.is_dir():
        return [path]
    metadata = path / "metadata.yaml"
    if os.path.lexists(metadata):
        check_yaml(metadata, expected="metadata of a ROS 2 recording", longest=_LONGEST_QOS)
        if not _BLANK_STORAGE.search(metadata.read_text(encoding="utf-8", errors="replace")):
            return [path]
    files = sorted(file for file in path.iterdir() if file.suffix in SUFFIXES_2)
    if not files:
        there = listed(sorted(os.listdir(path))) or "none"
        raise InputError(f"{path}: expected a ROS 2 recording with a .mcap or .db3 file, got {there}")
    return files


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


def _camera(reader: AnyReader, path: Path, topic: str, image: str) -> tuple[bytes, str]:
    """Return the camera file of the first CameraInfo message of a topic, and a note if later messages differ."""
    name = image.strip("/").replace("/", "_")
    files = Counter(camera_file(message, name, f"{path}: {topic}") for _, message in _messages(reader, path, topic))
    if not files:
        raise InputError(f"{path}: {topic}: expected a message, got none")
    first, others = next(iter(files)), files.total() - next(iter(files.values()))
    return first, f" (the first: {others} later messages differ from it)" if others else ""


@dataclass(frozen=True, eq=False)
class _Readings:
    """All readings of a topic, with the times in their headers and those of recording, ns, and notes."""

    topic: str
    joints: tuple[str, ...]
    values: list[list[float]]
    stamps: list[int]
    recorded: list[int]
    notes: tuple[str, ...]

    def series(self, by_recording: bool) -> TimedReadings:
        """Return the readings over the times of recording, or over those of the headers."""
        return TimedReadings.of(self.topic, self.joints, self.recorded if by_recording else self.stamps, self.values)

    @staticmethod
    def of(reader: AnyReader, path: Path, topic: str, arm: str | None, *, of_ecm: bool = False) -> _Readings:
        """Read a topic of an arm or of the endoscope's; messages without positions, as before it is up, are skipped."""
        where = f"{path}: {topic}"
        values, stamps, recorded, skipped, unnamed = list[dict[str, float]](), [], [], 0, False
        for time, message in _messages(reader, path, topic):
            of_joints = zip(ECM_JOINTS, ecm_values(message, where), strict=False) if of_ecm else ()
            row = dict(of_joints) if of_ecm else joint_values(message, where, arm)
            if not row:
                skipped += 1
                continue
            if values and row.keys() != values[0].keys():
                expected = f"expected a position of each of {', '.join(values[0])} in every message"
                raise InputError(f"{where}: {expected}, got {listed(row, 8)}")
            unnamed |= not of_ecm and not message.name
            values.append(row)
            stamps.append(stamp(message))
            recorded.append(time)
        if not values:
            raise InputError(f"{where}: expected messages with positions, got {skipped} without")
        notes = notes_on_messages(unnamed=unnamed, skipped=0 if of_ecm else skipped)
        joints = tuple(values[0])
        rows = [[row[name] for name in joints] for row in values]
        return _Readings(topic, joints, rows, stamps, recorded, notes)


def _images(path: Path, topic: str, recorded_times: bool) -> Iterator[RecordedImage]:
    """Yield the images of a topic; an image is decoded and encoded only when it is loaded."""
    with _open(path) as reader:
        for number, (time, message) in enumerate(_messages(reader, path, topic)):
            load = partial(image_file, message, f"{path}: {topic}: image {number}")
            yield RecordedImage(number, time if recorded_times else stamp(message), load)
