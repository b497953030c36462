"""Readers of videos with OpenCV, with camera and readings from separate files.

A folder with the videos of a stereo endoscope has one for each eye, named left and right (``left.mp4``,
``suturing_left.avi``), the cameras left.yaml and right.yaml or one camera.yaml, and joints.csv.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera.files import Side, guessed_camera, read_camera_file
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.video_frames import SUFFIXES, Video, Window, part_of
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.recording.camera import WITHOUT, read_camera_bytes
from dvrk_cmaes.recording.messages import encode_png
from dvrk_cmaes.recording.recording import Asked, RecordedImage, Recording

_EXPECTED = "a video that OpenCV reads, or a ROS recording (.bag, .mcap, .db3 or a folder)"
SIDES: Final[tuple[Side, ...]] = ("left", "right")


def open_video(path: Path, asked: Asked) -> Recording:
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
        advice = f"; {WITHOUT}" if camera is None else ""
        needed = "a video needs a camera file and a table of readings"
        raise InputError(f"{path}: {', '.join(missing)}: {needed}; got none{advice}")
    lens, asked = read_camera_bytes(camera), asked.read()
    readings, said = asked.given_readings()
    video = Video(path, _EXPECTED)
    seen_by = read_camera_file(camera, side=asked.eye, size=video.size) if lens else guessed_camera(video.size)
    window = video.window(seen_by.camera, asked.layout, asked.eye, asked.crop)
    notes = [
        f"camera: {camera}",
        *said,
        f"times: the video's, its first frame at {asked.start:g} s of the readings' clock",
    ]
    if window != (0, 0, *video.size):
        notes.append(f"images: {window[2]} x {window[3]} px at {window[0]}, {window[1]} of the video")
    start = round(asked.start * NANOSECONDS)
    images = images_of(video, lambda _, time: start + time, window=window)
    names = asked.row_names(video.stated)
    return Recording(path, images, video.stated, lens, {"": readings}, tuple(notes), names=names)


def has_stereo_videos(path: Path) -> bool:
    """Whether a folder has a video of each eye."""
    return path.is_dir() and all(_videos(path, side) for side in SIDES)


def open_stereo_videos(path: Path, asked: Asked) -> Recording:
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
    recording = open_video(videos[0], replace(asked, camera=asked.camera or camera, joints=asked.joints or joints))
    return replace(recording, path=path, notes=(f"images: {videos[0].name}", *recording.notes))


def _videos(path: Path, side: Side) -> list[Path]:
    """List the videos whose names have a side's name as a word, e.g. ``left``, ``left_eye`` or ``PSM1-left``."""
    videos = (file for file in sorted(path.iterdir()) if file.suffix.lower() in SUFFIXES)
    return [file for file in videos if side in re.split(r"[-._]", file.stem.lower())]


def images_of(
    video: Video,
    time_of: Callable[[int, int], int | None],
    *,
    count: int | None = None,
    expected: str = "",
    first: int = 0,
    window: Window | None = None,
) -> Iterator[RecordedImage]:
    """Yield the frames of a video as images that are counted from ``first``.

    ``time_of`` returns the time of a frame, ns, given its number and its time in the video; None for one to leave out.
    Of a video with at least ``count`` frames, InputError says that these are ``expected`` if it ends before. ``window``
    is the part of the pictures that is one eye's.
    """
    part, frames = window or (0, 0, *video.size), 0
    for number, own, decoded in islice(video.frames(), count):
        frames = number + 1
        if (time := time_of(number, own)) is not None:
            yield RecordedImage(number - first, time, partial(_png_of, decoded, part))
    if count is not None and frames < count:
        raise InputError(f"{video.path}: expected {count} images{expected}, got {frames}")


def _png_of(decoded: Callable[[], NDArray[np.uint8]], part: Window) -> bytes:
    """Decode a frame, and encode a part of it as PNG."""
    return encode_png(part_of(decoded(), part))
