"""Frames of a video file, read one after the other with OpenCV, whole or one eye's part of a stereo picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import count
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.image_header import check_pixels
from dvrk_cmaes.io.video_writer import quiet_ffmpeg
from dvrk_cmaes.joints.interpolation import NANOSECONDS

Layout = Literal["mono", "side-by-side", "top-bottom"]
"""Where the eyes are in a picture."""

Window = tuple[int, int, int, int]
"""Left, top, width and height of a part of a picture, px."""

_SILENT = 0  # level of the log of OpenCV
SUFFIXES: Final = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".ts", ".webm", ".wmv")
EXPECTED: Final = "a video that OpenCV reads"
_SAME_ASPECT = 0.02  # largest relative difference of two aspect ratios that count as one
_SAME_RATE = 0.01  # largest relative difference of two rates that count as one


class Video:
    """A video: its size, its rate, the times of its frames, and its frames in any order, quickest in that of the video.

    ``size`` is (width, height), px. ``stated`` is the number of frames that the file states, None if it states none.

    Raises
    ------
    InputError
        The file is missing or no video, or one of too large pictures.
    """

    def __init__(self, path: Path, expected: str = EXPECTED) -> None:
        check_file(path, expected=expected)
        self.path, self._expected = path, expected
        capture = self._opened()
        width, height = (int(capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        check_pixels(str(path), width, height)
        self.size = width, height
        self.stated = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT))) or None
        self._rate = capture.get(cv2.CAP_PROP_FPS)
        self._frames: Iterator[tuple[int, int, Callable[[], NDArray[np.uint8]]]] = iter(())
        self._next: float = math.inf

    def _opened(self) -> Any:
        """Open the file with OpenCV's FFmpeg backend, without log output; others take file names for patterns."""
        log = getattr(cv2.utils, "logging", cv2)  # from OpenCV 5 on in a module of its own
        level = log.getLogLevel()
        log.setLogLevel(_SILENT)
        quiet_ffmpeg()
        capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        log.setLogLevel(level)
        if not capture.isOpened():
            raise InputError(f"{self.path}: expected {self._expected}, got something else or a damaged file")
        return capture

    def __reduce__(self) -> tuple[Any, ...]:
        """Send the video to another process, which opens the file once for all frames that it is sent."""
        return _video_of, (self.path,)

    @cached_property
    def times(self) -> tuple[int, ...]:
        """Times of the frames, ns after the beginning; InputError if there are none, or they do not increase."""
        times = tuple(time for _, time, _ in self.frames())
        if not times:
            raise InputError(f"{self.path}: expected {EXPECTED}, got one without frames")
        late = next((k for k in range(1, len(times)) if times[k] <= times[k - 1]), None)
        if late is not None:
            after = times[late - 1] / NANOSECONDS
            raise InputError(f"{self.path}: frame {late}: expected a later time than {after:g} s, got none")
        return times

    def frames(self) -> Iterator[tuple[int, int, Callable[[], NDArray[np.uint8]]]]:
        """Yield the number and the time, ns, of each frame, and what decodes it, (H, W, 3) uint8 BGR, before the next.

        Decoding raises `InputError` if it is not possible.
        """
        capture = self._opened()

        def decoded() -> NDArray[np.uint8]:
            there, pixels = capture.retrieve()
            if not there:
                raise InputError(f"{self.path}: frame {number}: expected an image, got one that cannot be decoded")
            return np.asarray(pixels, np.uint8)

        for number in count():
            if not capture.grab():
                return
            yield number, round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6), decoded

    def image(self, number: int) -> NDArray[np.uint8]:
        """Decode a frame, (H, W, 3) uint8 BGR; InputError if that is not possible."""
        if number < self._next:
            self._frames = self.frames()
        self._next = number + 1
        for at, _, decoded in self._frames:
            if at == number:
                return decoded()
        raise InputError(f"{self.path}: frame {number}: expected an image, got one that cannot be decoded")

    def check_rate(self, rate: float, why: str) -> None:
        """Raise an InputError for a video that has another rate, images a second, than the one that is expected."""
        if not abs(self._rate - rate) < _SAME_RATE * rate:
            raise InputError(
                f"{self.path}: expected {rate:g} images a second, {why}, got {self._rate:g}; convert it to {rate:g} "
                "first"
            )

    def window(self, camera: Camera | None, layout: Layout | None, side: Side, crop: Window | None = None) -> Window:
        """Return the part of the picture that is one eye's.

        ``layout`` is found from the aspect of the camera's images if it is None; without a camera it is ``mono``. A
        ``crop`` counts in its place.

        Raises
        ------
        InputError
            The picture's size fits the camera in no layout, or not in the one that is given.
        """
        width, height = self.size
        second, half = side == "right", (width // 2, height // 2)
        parts: dict[Layout, Window] = {
            "mono": (0, 0, width, height),
            "side-by-side": (second * (width - half[0]), 0, half[0], height),
            "top-bottom": (0, second * (height - half[1]), width, half[1]),
        }
        if crop is not None:
            check_crop(self.path, crop, self.size)
            layout, parts["mono"] = "mono", crop
        fitting = [name for name, part in parts.items() if camera is None or _is_like(part, camera)]
        layout = layout or next(iter(fitting), None)
        if layout in fitting:
            return parts[layout]
        assert camera is not None
        own = f"{camera.width} x {camera.height}"
        if layout is None:
            raise InputError(
                f"{self.path}: expected the calibration's {own}, or two such pictures side by side or one above the "
                f"other, got {width} x {height} (--layout: another arrangement; --crop: a part)"
            )
        got = f"{parts[layout][2]} x {parts[layout][3]}"
        expected = f"expected pictures of the aspect of the calibration's {own}"
        raise InputError(f"{self.path}: --layout {layout}: {expected}, got {got}")


@lru_cache(maxsize=4)
def _video_of(path: Path) -> Video:
    """Return the video of a file, which is opened once: the cache of the class itself could not be pickled."""
    return Video(path)


def _is_like(part: Window, camera: Camera) -> bool:
    """Whether a part of a picture has the aspect of a camera's images."""
    width, height = part[2] * camera.height, part[3] * camera.width
    return abs(width - height) < _SAME_ASPECT * height


def check_crop(path: Path, crop: Window, size: tuple[int, int]) -> None:
    """Raise an InputError for a part of a picture of a size (width, height), px, that is not inside."""
    if crop[0] + crop[2] > size[0] or crop[1] + crop[3] > size[1]:
        got = ",".join(map(str, crop))
        raise InputError(f"{path}: --crop: expected a part of {size[0]} x {size[1]} px, got {got}")


def own_video(folder: Path) -> Path | None:
    """Return the video of a session folder; None if it has none, or a folder of images."""
    path = folder / "video.mp4"
    return path if path.exists() and not (folder / "images").is_dir() else None


def frame_name(number: int) -> str:
    """Return the name in a session of the image of a number, from zero."""
    return f"{number:06d}"


def part_of(picture: NDArray[Any], window: Window) -> NDArray[Any]:
    """Return a part of a picture (H, W, ...), such as one eye's."""
    left, top, width, height = window
    return np.ascontiguousarray(picture[top : top + height, left : left + width])


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """A frame of a video, by its number from zero; of its picture, the ``window`` of one eye."""

    video: Video
    number: int
    window: Window

    def image(self) -> NDArray[np.uint8]:
        """Decode the frame's window, (H, W, 3) uint8 BGR."""
        return part_of(self.video.image(self.number), self.window)
