"""Reader of videos with OpenCV, with camera and readings from separate files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.video_frames import open_capture
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.rows import JointFile
from dvrk_cmaes.recording.camera import read_camera_bytes
from dvrk_cmaes.recording.messages import encode_png
from dvrk_cmaes.recording.pose_table import PoseTable
from dvrk_cmaes.recording.reading_table import read_timed_joints
from dvrk_cmaes.recording.recording import ImageFile, RecordedImage, Recording

_EXPECTED = "a video that OpenCV reads, or a ROS recording (.bag, .mcap, .db3 or a folder)"


@contextmanager
def open_video(
    path: Path, *, camera: Path | None, joints: Path | PoseTable | JointFile | None, start: float = 0.0
) -> Iterator[Recording]:
    """Open a video; images are decoded during iteration.

    Parameters
    ----------
    path
        The video.
    camera, joints
        Camera file, and file of time-stamped readings; both are required.
    start
        Time of the video's first frame in the time of the readings, s.

    Raises
    ------
    InputError
        A file is missing or not valid, or the video cannot be read.
    """
    check_file(path, expected=_EXPECTED)
    if camera is None or joints is None:
        missing = "--camera" if camera is None else "--joints"
        raise InputError(f"{path}: {missing}: a video needs a camera file and a table of readings; got none")
    lens, readings = read_camera_bytes(camera), read_timed_joints(joints)
    with open_capture(path, expected=_EXPECTED) as capture:
        total = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        notes = (
            f"camera: {camera}",
            *(f"{' '.join(series.joints)}: {joints}" for series in readings),
            f"times: the video's, its first frame at {start:g} s of the readings' clock",
        )
        images = _images(path, capture, round(start * NANOSECONDS))
        yield Recording(path, images, total if total > 0 else None, lens, readings, notes)


def _images(path: Path, capture: Any, start: int) -> Iterator[RecordedImage]:
    """Yield the frames of a video, each with its presentation time plus ``start``, ns."""
    number, before = 0, -1
    while capture.grab():
        time = round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        if time <= before:
            raise InputError(f"{path}: frame {number}: expected a later time than {before / NANOSECONDS:g} s, got none")
        yield RecordedImage(number, start + time, lambda number=number: decoded_frame(path, capture, number))  # type: ignore[misc]
        number, before = number + 1, time


def decoded_frame(path: Path, capture: Any, number: int) -> ImageFile:
    """Decode the frame last grabbed from a capture and encode it as PNG; InputError if it cannot be decoded."""
    decoded, pixels = capture.retrieve()
    if not decoded:
        raise InputError(f"{path}: frame {number}: expected an image, got one that cannot be decoded")
    return encode_png(np.asarray(pixels, np.uint8))
