"""Videos that are written under a temporary name and renamed when they are complete, and FFmpeg without log output."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.io.output import whole_file

_QUIET: Final = "-8"  # FFmpeg's AV_LOG_QUIET


def quiet_ffmpeg() -> None:
    """Let FFmpeg print nothing of its own; to be called before each use, as OpenCV reads this at FFmpeg's first."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", _QUIET)


@contextmanager
def whole_video(path: Path, size: tuple[int, int], frames_a_second: float) -> Iterator[Any]:
    """Open an mp4 video of a size, (width, height) px, as a ``cv2.VideoWriter``; it takes images (H, W, 3) BGR.

    Raises
    ------
    InputError
        The video cannot be written there.
    DvrkCmaesError
        OpenCV cannot encode the video.
    """
    quiet_ffmpeg()
    with whole_file(path, "a video") as temporary:
        video = cv2.VideoWriter(str(temporary), cv2.VideoWriter.fourcc(*"mp4v"), frames_a_second, size)
        if not video.isOpened():
            raise DvrkCmaesError(f"{path}: OpenCV cannot write an mp4 video there")
        try:
            yield video
        finally:
            video.release()
