"""Common interface of all recordings: a sequence of images, time series of readings, and a camera."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.joints.interpolation import NANOSECONDS, TimedReadings
from dvrk_cmaes.joints.reading import read_joint_file
from dvrk_cmaes.joints.rows import JointFile
from dvrk_cmaes.recording.pose_table import PoseTable, read_timed_joints

_DIGITS = 6  # number of digits of a frame's name
_PLAIN = re.compile(r"[\w-][\w.-]*")  # a row's name that is also that of a file


def frame_name(number: int) -> str:
    """Return the name in a session of the image of a number, from zero."""
    return f"{number:0{_DIGITS}d}"


@dataclass(frozen=True)
class Asked:
    """What of a recording is read, and the files that are used instead of its own.

    side : the eye whose images are read. arm : name of the arm, e.g. PSM1; None for the only one. camera, joints : a
    camera file, and a file of readings by time. start : time of a video's first image in that of the readings, s.
    """

    side: Side = "left"
    arm: str | None = None
    camera: Path | None = None
    joints: Path | PoseTable | JointFile | None = None
    start: float = 0.0

    def read(self) -> Asked:
        """Return the same with the file of readings read."""
        return replace(self, joints=read_joint_file(self.joints)) if isinstance(self.joints, Path) else self

    def row_names(self, count: int) -> tuple[str, ...]:
        """Return the names of frames that the rows of the readings have, if these were read and are ``count``."""
        file = self.joints
        names = tuple(file.names) if isinstance(file, JointFile) and file.labels == "frame" else ()
        return names if len(names) == count and all(map(_PLAIN.fullmatch, names)) else ()

    def given_readings(self) -> tuple[tuple[TimedReadings, ...], list[str]]:
        """Read ``joints``, and say which file each joint is from; none where no file is given."""
        readings = () if self.joints is None else read_timed_joints(self.joints)
        return readings, [f"{' '.join(series.joints)}: {series.source}" for series in readings]


@dataclass(frozen=True)
class ImageFile:
    """A PNG or JPEG file in memory: its bytes, its extension, and the image size in pixels."""

    data: bytes
    extension: str
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class RecordedImage:
    """An image of a recording: its number, from zero, its time, ns, and a function that loads it.

    ``load`` must be called before the next image is requested. Images that are not loaded are not decoded.
    """

    number: int
    time: int
    load: Callable[[], ImageFile]


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
        Bytes of a camera file.
    readings
        A time series for each source, e.g. one topic of the arm and one of the jaw.
    notes
        The choices that were made, e.g. of topics and time source, one sentence each.
    kept
        Further files that are copied to the session folder: their bytes by their path in it.
    right
        The recording of the right eye, of which images and camera are used; None for one eye.
    arms
        The readings of each of several arms by its name, in place of ``readings``.
    rectified
        Whether the images are rectified.
    has_images
        Whether there are images; a recording of readings alone has no camera either.
    names
        Names of the images, in their order, where the table of readings has as many rows with names of frames.
    """

    path: Path
    images: Iterator[RecordedImage]
    total: int | None
    camera: bytes
    readings: tuple[TimedReadings, ...]
    notes: tuple[str, ...]
    kept: Mapping[str, bytes] = field(default_factory=dict)
    right: Recording | None = None
    arms: Mapping[str, tuple[TimedReadings, ...]] = field(default_factory=dict)
    rectified: bool = False
    has_images: bool = True
    names: tuple[str, ...] = ()

    def name(self, number: int) -> str:
        """Return the name in a session of the image of a number."""
        return self.names[number] if number < len(self.names) else frame_name(number)


_FARTHEST: Final = NANOSECONDS // 100  # ns, between the images of a pair: less than half of the time between images


@contextmanager
def both_eyes(open_eye: Callable[[Side], AbstractContextManager[Recording]]) -> Iterator[Recording]:
    """Open the recordings of both eyes, the right one as ``right`` of the left one; errors as ``open_eye``."""
    with open_eye("left") as left, open_eye("right") as right:
        of_right = tuple(f"right eye: {note}" for note in right.notes if note.startswith(("images:", "camera:")))
        yield replace(left, right=right, notes=(*left.notes, *of_right))


@dataclass
class Pairing:
    """Pairs images of the right eye with those of the left one, and summarises how far apart they are.

    ``without`` counts the images without a partner, ``farthest`` is the largest distance in time within a pair, ns.
    """

    images: Iterator[RecordedImage]
    without: int = 0
    farthest: int = 0
    _next: RecordedImage | None = None

    def partner(self, time: int) -> RecordedImage | None:
        """Return the image of the right eye taken at a time, ns; None if there is none within 10 ms.

        The times of successive calls must increase.
        """
        while self._next is None or self._next.time < time - _FARTHEST:
            self._next = next(self.images, None)
            if self._next is None:
                break
        if self._next is None or self._next.time > time + _FARTHEST:
            self.without += 1
            return None
        image, self._next = self._next, None
        self.farthest = max(self.farthest, abs(image.time - time))
        return image
