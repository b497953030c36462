"""Readers of videos with OpenCV, with camera and readings from separate files.

A folder with the videos of a stereo endoscope has one for each eye, named left and right (``left.mp4``,
``suturing_left.avi``), the cameras left.yaml and right.yaml or one camera.yaml, and joints.csv.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import count as numbers
from itertools import islice
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from dvrk_cmaes.camera.files import Side, read_camera_file
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.session_folder import UNCALIBRATED
from dvrk_cmaes.frames.video_frames import SUFFIXES, Window, eye_of, eye_window, open_capture
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.recording.camera import read_camera_bytes
from dvrk_cmaes.recording.messages import encode_png
from dvrk_cmaes.recording.recording import Asked, RecordedImage, Recording

_EXPECTED = "a video that OpenCV reads, or a ROS recording (.bag, .mcap, .db3 or a folder)"
_RATE_TOLERANCE = 0.01
_SIDES: Final[tuple[Side, ...]] = ("left", "right")


@contextmanager
def open_video(path: Path, asked: Asked) -> Iterator[Recording]:
    """Open a video; images are decoded during iteration.

    Parameters
    ----------
    path
        The video.
    asked
        Camera file, and file of time-stamped readings, which are both required, and what the pictures are.

    Raises
    ------
    InputError
        A file is missing or not valid, the video cannot be read, or its pictures do not fit the camera file.
    """
    check_file(path, expected=_EXPECTED)
    camera = asked.camera
    if camera is None or asked.joints is None:
        missing = ["--camera"] * (camera is None) + ["--joints"] * (asked.joints is None)
        advice = f"; {UNCALIBRATED}" if camera is None else ""
        needed = "a video needs a camera file and a table of readings"
        raise InputError(f"{path}: {', '.join(missing)}: {needed}; got none{advice}")
    lens, asked = read_camera_bytes(camera), asked.read()
    readings, said = asked.given_readings()
    with open_capture(path, expected=_EXPECTED) as capture:
        total = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        size = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        lens_of_eye = read_camera_file(camera, side=asked.eye, size=size).camera
        window = eye_window(path, size, lens_of_eye, asked.layout, asked.eye, asked.crop)
        notes = [
            f"camera: {camera}",
            *said,
            f"times: the video's, its first frame at {asked.start:g} s of the readings' clock",
        ]
        if window != (0, 0, *size):
            notes.append(f"images: {window[2]} x {window[3]} px at {window[0]}, {window[1]} of the video")
        start = round(asked.start * NANOSECONDS)
        recorded = frames_of(
            path, capture, lambda _: start + round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6), window=window
        )
        yield Recording(
            path,
            recorded,
            total if total > 0 else None,
            lens,
            {"": readings},
            tuple(notes),
            names=asked.row_names(total),
        )


def has_stereo_videos(path: Path) -> bool:
    """Whether a folder has a video of each eye."""
    return path.is_dir() and all(_videos(path, side) for side in _SIDES)


@contextmanager
def open_stereo_videos(path: Path, asked: Asked) -> Iterator[Recording]:
    """Open the video of one eye; camera and joints as in ``open_video``, by default the folder's.

    Raises
    ------
    InputError
        The folder has no video of this eye or several, or as in ``open_video``.
    """
    side, videos = asked.eye, _videos(path, asked.eye)
    if len(videos) != 1:
        there = f"several: {listed(video.name for video in videos)}" if videos else "none"
        raise InputError(f"{path}: expected one video of the {side} eye, got {there}")
    usual = [[path / name for name in names] for names in ((f"{side}.yaml", "camera.yaml"), ("joints.csv",))]
    camera, joints = (next((file for file in files if file.exists()), None) for files in usual)
    asked = replace(asked, camera=asked.camera or camera, joints=asked.joints or joints)
    with open_video(videos[0], asked) as recording:
        yield replace(recording, path=path, notes=(f"images: {videos[0].name}", *recording.notes))


def _videos(path: Path, side: Side) -> list[Path]:
    """List the videos whose names have a side's name as a word, e.g. ``left``, ``left_eye`` or ``PSM1-left``."""
    return [
        file
        for file in sorted(path.iterdir())
        if file.suffix.lower() in SUFFIXES and side in file.stem.lower().replace("-", "_").replace(".", "_").split("_")
    ]


def frames_of(
    path: Path,
    capture: Any,
    time_of: Callable[[int], int | None],
    *,
    count: int | None = None,
    expected: str = "",
    first: int = 0,
    window: Window | None = None,
) -> Iterator[RecordedImage]:
    """Yield the frames of a video whose numbers have times, ns, as images that are counted from ``first``.

    Of a video with at least ``count`` frames, InputError says that these are ``expected`` if it ends before. ``window``
    is the part of the pictures that is one eye's.
    """
    for number in islice(numbers(), count):
        if not capture.grab():
            if count is None:
                return
            raise InputError(f"{path}: expected {count} images{expected}, got {number}")
        time = time_of(number)
        if time is not None:
            yield RecordedImage(number - first, time, partial(decoded_frame, path, capture, number, window))


def check_rate(path: Path, capture: Any, rate: float, why: str) -> None:
    """Raise an InputError for a video that has another rate, images a second, than the one that is expected."""
    found = capture.get(cv2.CAP_PROP_FPS)
    if not abs(found - rate) < _RATE_TOLERANCE * rate:
        raise InputError(
            f"{path}: expected {rate:g} images a second, {why}, got {found:g}; convert it to {rate:g} first"
        )


def decoded_frame(path: Path, capture: Any, number: int, window: Window | None = None) -> bytes:
    """Decode the frame last grabbed from a capture, or its part that is one eye's, and encode it as PNG.

    InputError if it cannot be decoded.
    """
    decoded, pixels = capture.retrieve()
    if not decoded:
        raise InputError(f"{path}: frame {number}: expected an image, got one that cannot be decoded")
    picture = np.asarray(pixels, np.uint8)
    return encode_png(picture if window is None else eye_of(picture, window))
