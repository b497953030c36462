"""Frames of a video file, read one after the other with OpenCV, whole or one eye's part of a stereo picture."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.image_header import MOST_PIXELS
from dvrk_cmaes.io.video_writer import quiet_ffmpeg
from dvrk_cmaes.joints.interpolation import NANOSECONDS

Layout = Literal["mono", "side-by-side", "top-bottom"]
"""Where the eyes are in a picture."""

Window = tuple[int, int, int, int]

_SILENT = 0  # level of the log of OpenCV
SUFFIXES: Final = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".ts", ".webm", ".wmv")
EXPECTED: Final = "a video that OpenCV reads"
_SAME_ASPECT = 0.02  # largest relative difference of two aspect ratios that count as one


@contextmanager
def open_capture(path: Path, *, expected: str = EXPECTED) -> Iterator[Any]:
    """Open a video with OpenCV's FFmpeg backend, without log output; others take file names for patterns.

    Raises
    ------
    InputError
        Not a video, or one of too large pictures.
    """
    log = getattr(cv2.utils, "logging", cv2)  # from OpenCV 5 on in a module of its own
    level = log.getLogLevel()
    log.setLogLevel(_SILENT)
    quiet_ffmpeg()
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        if not capture.isOpened():
            raise InputError(f"{path}: expected {expected}, got something else or a damaged file")
        width, height = (int(capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > MOST_PIXELS:
            raise InputError(f"{path}: expected at most {MOST_PIXELS // 10**6} megapixels, got {width} x {height}")
        yield capture
    finally:
        capture.release()
        log.setLogLevel(level)


class Video:
    """A video: its size, the times of its frames, and its frames in any order, quickest in that of the video.

    Raises
    ------
    InputError
        The file is missing or no video, has no frames, or its times do not increase.
    """

    def __init__(self, path: Path) -> None:
        check_file(path, expected=EXPECTED)
        self.path = path
        times = []
        with open_capture(path) as capture:
            width, height = (int(capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
            self.size = width, height
            while capture.grab():
                times.append(round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6))
        if not times:
            raise InputError(f"{path}: expected {EXPECTED}, got one without frames")
        late = next((k for k in range(1, len(times)) if times[k] <= times[k - 1]), None)
        if late is not None:
            after = times[late - 1] / NANOSECONDS
            raise InputError(f"{path}: frame {late}: expected a later time than {after:g} s, got none")
        self.times: tuple[int, ...] = tuple(times)
        """Of the frames, ns after the beginning."""
        self._capture: Any = None
        self._next = 0

    def __reduce__(self) -> tuple[Any, ...]:
        """Send the video to another process, which opens the file once for all frames that it is sent."""
        return _sent_video, (self.path, self.size, self.times)

    def image(self, number: int) -> NDArray[np.uint8]:
        """Decode a frame, (H, W, 3) uint8 BGR; InputError if that is not possible."""
        if self._capture is None or number < self._next:
            self._capture, self._next = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG), 0
        while self._next < number and self._capture.grab():
            self._next += 1
        decoded, pixels = self._capture.read()
        self._next += 1
        if not decoded:
            raise InputError(f"{self.path}: frame {number}: expected an image, got one that cannot be decoded")
        return np.asarray(pixels, np.uint8)

    def window(self, camera: Camera | None, layout: Layout | None, side: Side) -> Window:
        """Return the part of the picture that is one eye's; arguments and errors as of `eye_window`."""
        return eye_window(self.path, self.size, camera, layout, side)


def own_video(folder: Path) -> Path | None:
    """Return the video of a session folder; None if it has none, or a folder of images."""
    path = folder / "video.mp4"
    return path if path.exists() and not (folder / "images").is_dir() else None


def eye_of(picture: NDArray[np.uint8], window: Window) -> NDArray[np.uint8]:
    """Return the part of a picture (H, W, ...) that is one eye's."""
    left, top, width, height = window
    return np.ascontiguousarray(picture[top : top + height, left : left + width])


def eye_window(
    path: Path,
    size: tuple[int, int],
    camera: Camera | None,
    layout: Layout | None,
    side: Side,
    crop: Window | None = None,
) -> Window:
    """Return the part of a picture of a ``size`` (width, height), px, that is one eye's.

    ``layout`` is found from the aspect of the camera's images if it is None; without a camera it is ``mono``. A
    ``crop`` counts in its place.

    Raises
    ------
    InputError
        The picture's size fits the camera in no layout, or not in the one that is given.
    """
    width, height = size
    if crop is not None:
        if crop[0] + crop[2] > width or crop[1] + crop[3] > height:
            raise InputError(
                f"{path}: --crop: expected a part of {width} x {height} px, got {','.join(map(str, crop))}"
            )
        layout = "mono"
    if layout is None:
        layout = "mono" if camera is None else _layout(path, size, camera)
    second = side == "right"
    part = (0, 0, width, height) if crop is None else crop
    if layout == "side-by-side":
        part = second * (width - width // 2), 0, width // 2, height
    elif layout == "top-bottom":
        part = 0, second * (height - height // 2), width, height // 2
    if camera is not None and not _is_like(part[2] / part[3], camera):
        raise InputError(
            f"{path}: --layout {layout}: expected pictures of the aspect of the calibration's {camera.width} x "
            f"{camera.height}, got {part[2]} x {part[3]}"
        )
    return part


def _is_like(aspect: float, camera: Camera) -> bool:
    """Whether an aspect is that of a camera's images."""
    return abs(aspect * camera.height / camera.width - 1) < _SAME_ASPECT


def _layout(path: Path, size: tuple[int, int], camera: Camera) -> Layout:
    """Find the layout in which a picture has the aspect of a camera's images."""
    width, height = size
    fitting: tuple[tuple[Layout, float], ...] = (
        ("mono", width / height),
        ("side-by-side", width / (2 * height)),
        ("top-bottom", 2 * width / height),
    )
    for layout, own in fitting:
        if _is_like(own, camera):
            return layout
    raise InputError(
        f"{path}: expected the calibration's {camera.width} x {camera.height}, or two such pictures side by side or "
        f"one above the other, got {width} x {height} (--layout: another arrangement; --crop: a part)"
    )


@lru_cache(maxsize=4)
def _sent_video(path: Path, size: tuple[int, int], times: tuple[int, ...]) -> Video:
    """Return the video of a file whose size and times were read in another process."""
    video = Video.__new__(Video)
    video.path, video.size, video.times = path, size, times
    video._capture, video._next = None, 0
    return video


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """A frame of a video, by its number from zero; of its picture, the ``window`` of one eye."""

    video: Video
    number: int
    window: Window

    def image(self) -> NDArray[np.uint8]:
        """Decode the frame's window, (H, W, 3) uint8 BGR."""
        return eye_of(self.video.image(self.number), self.window)
