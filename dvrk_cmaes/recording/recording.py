"""What a recording gives, whether it is a bag or a video: images in order, readings over time, a camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from dvrk_cmaes.joints.interpolation import TimedReadings


@dataclass(frozen=True)
class ImageFile:
    """An image as it is stored: the bytes of a PNG or JPEG file, and its size in pixels."""

    data: bytes
    extension: str
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class RecordedImage:
    """An image of a recording: its number, counted from zero, its time in ns, and how to get at it.

    ``load`` may be called until the next image is asked for; an image that is left out costs nothing.
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
        Where it lies, for messages.
    images
        In the order of the recording; they can be gone through once.
    total
        How many images it says it has; None if it does not say.
    camera
        A camera file, as ``read_camera`` reads it.
    readings
        From each source, e.g. one topic for the arm and one for the jaw.
    notes
        In words, what was decided on the way: which topics, whose clock.
    """

    path: Path
    images: Iterator[RecordedImage]
    total: int | None
    camera: bytes
    readings: tuple[TimedReadings, ...]
    notes: tuple[str, ...]
