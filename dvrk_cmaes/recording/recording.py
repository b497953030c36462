"""Common interface of all recordings: a sequence of images, time series of readings, and a camera."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.video_frames import Layout, Window, frame_name
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.instrument.dvrk_description import Tool
from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.joints.names import joint_reading, joints_by_count
from dvrk_cmaes.joints.reading import read_joint_file
from dvrk_cmaes.joints.rows import JointFile, ReadAs
from dvrk_cmaes.recording.pose_table import PosePoint

_PLAIN = re.compile(r"[\w-][\w.-]*")  # a row's name that is also that of a file


@dataclass(frozen=True)
class Asked:
    """What of a recording is read, and the files that are used instead of its own.

    Parameters
    ----------
    side
        The eye whose images are read; None for the left one, or the only one.
    both
        Whether the other eye is read, too.
    arms
        Names of the arms whose readings are read, e.g. PSM1; none for the only one. Several of a ROS recording alone.
    camera, joints
        A camera file, and a file of readings by time, or time series that were read already.
    columns
        Names of the columns of a CSV of readings, in place of its header.
    start
        Time of a video's first image in that of the readings, s.
    layout, crop
        Of a video: where the eyes are in a picture, and its part that is used, as in `Video.window`.
    episode
        Number of the episode of a LeRobot data set.
    posed
        What poses of a LeRobot data set mean: point, reference_from_base, arm and tool as of `read_pose_table`; None
        for poses of the tip in the base of a classic arm.
    image_topic, image_topic_right, camera_topic, joints_topic, jaw_topic
        Topics of a ROS recording; None to find one automatically, ``none`` to use none.
    recorded_times
        Use the times at which messages were recorded instead of those in their headers. This is also done, with a note,
        if the headers of a topic have no times, or times that do not advance.
    rectified
        Whether the images of a ROS recording are rectified.
    """

    side: Side | None = None
    both: bool = False
    arms: tuple[str, ...] = ()
    camera: Path | None = None
    joints: Path | JointFile | tuple[TimedReadings, ...] | None = None
    columns: tuple[str, ...] = ()
    start: float = 0.0
    layout: Layout | None = None
    crop: Window | None = None
    episode: int = 0
    posed: tuple[PosePoint, Float64, Arm, Tool | None] | None = None
    image_topic: str | None = None
    image_topic_right: str | None = None
    camera_topic: str | None = None
    joints_topic: str | None = None
    jaw_topic: str | None = None
    recorded_times: bool = False
    rectified: bool = False

    @property
    def eye(self) -> Side:
        """The eye whose images are read."""
        return self.side or "left"

    @property
    def arm(self) -> str | None:
        """The arm whose readings are read; None for the only one."""
        return self.arms[0] if self.arms else None

    def read(self, arm: str | None = None) -> Asked:
        """Return the same with the file of readings read, of one with those of several arms those of ``arm``."""
        if not isinstance(self.joints, Path):
            return self
        return replace(self, joints=read_joint_file(self.joints, read_as=ReadAs(arm, self.columns)))

    def row_names(self, count: int | None) -> tuple[str, ...]:
        """Return the names of frames that the rows of the readings have, if these were read and are ``count``."""
        file = self.joints
        names = tuple(file.names) if isinstance(file, JointFile) and file.labels == "frame" else ()
        return names if len(names) == count and all(map(_PLAIN.fullmatch, names)) else ()

    def given_readings(self, arm: str | None = None) -> tuple[tuple[TimedReadings, ...], list[str]]:
        """Read ``joints``, and say which file each joint is from; none where no file is given.

        InputError for a file that is not one of readings, or whose rows have no times.
        """
        given = self.read(arm).joints
        if isinstance(given, JointFile) and not given.timed:
            got = f"rows of {', '.join(given.joints)} without"
            expected = "joint readings with times (a column time, in seconds)"
            raise InputError(f"{given.path}: expected {expected}, got {got}")
        assert not isinstance(given, Path)
        readings = given.timed if isinstance(given, JointFile) else given or ()
        return readings, [f"{' '.join(series.joints)}: {series.source}" for series in readings]


@dataclass(frozen=True, eq=False)
class RecordedImage:
    """An image of a recording: its number, from zero, its time, ns, and a function that loads it as a PNG or JPEG file.

    ``load`` must be called before the next image is requested. Images that are not loaded are not decoded.
    """

    number: int
    time: int
    load: Callable[[], bytes]


@dataclass(frozen=True, eq=False)
class Recording:
    """An open recording.

    Parameters
    ----------
    path
        Path of the recording, for messages.
    images
        The images in the order of the recording; they can be iterated once.
    total
        Number of images stated by the recording; None if it is not stated.
    camera
        Bytes of a camera file; empty without one, as of a recording of readings alone.
    arms
        By the name of the arm, "" for one that is not named: a time series for each source, e.g. one topic of the arm
        and one of the jaw.
    notes
        The choices that were made, e.g. of topics and time source, one sentence each.
    kept
        Further files that are copied to the session folder: their bytes by their path in it.
    right
        The recording of the right eye, of which images and camera are used; None for one eye.
    rectified
        Whether the images are rectified.
    names
        Names of the images, in their order, where the table of readings has as many rows with names of frames.
    masks
        What has masks of the images, as of `write_session.write_masks`; None for a session without.
    """

    path: Path
    images: Iterator[RecordedImage]
    total: int | None
    camera: bytes
    arms: Mapping[str, tuple[TimedReadings, ...]]
    notes: tuple[str, ...]
    kept: Mapping[str, bytes] = field(default_factory=dict)
    right: Recording | None = None
    rectified: bool = False
    names: tuple[str, ...] = ()
    masks: Path | None = None

    @property
    def pictured(self) -> bool:
        """Whether it has images."""
        return self.total != 0

    def name(self, number: int) -> str:
        """Return the name in a session of the image of a number."""
        return self.names[number] if number < len(self.names) else frame_name(number)


def listed_readings(where: str, value: Any) -> dict[str, float]:
    """Return the readings of a cell: a list of an arm's joints, or the jaw's; InputError begins with ``where``."""
    if not isinstance(value, list):
        return {"jaw": joint_reading(where, "jaw", value)}
    names = joints_by_count(where, len(value))
    return {name: joint_reading(where, name, cell) for name, cell in zip(names, value, strict=True)}


Rows = Mapping[int, Mapping[str, float]]
"""Readings by joint, of frames by their number."""


def series_of_rows(source: str, rows: Rows, time_of: Callable[[int], int]) -> TimedReadings:
    """Return the series of rows of the same joints, by number; InputError if there are none, or of other joints."""
    if not rows:
        raise InputError(f"{source}: expected the joints of at least one frame, got none")
    names = tuple(next(iter(rows.values())))
    for number, row in rows.items():
        if tuple(row) != names:
            raise InputError(
                f"{source}: frame {number}: expected {len(names)} values as in the frames before, got {len(row)}"
            )
    return TimedReadings.of(source, names, [time_of(k) for k in rows], [list(row.values()) for row in rows.values()])
