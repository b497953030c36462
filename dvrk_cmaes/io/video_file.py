"""Videos that are written beside their place and renamed when they are complete."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.io.atomic import written_beside


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
    with written_beside(path, "a video") as beside:
        video = cv2.VideoWriter(str(beside), cv2.VideoWriter.fourcc(*"mp4v"), frames_a_second, size)
        if not video.isOpened():
            raise DvrkCmaesError(f"{path}: OpenCV cannot write an mp4 video there")
        try:
            yield video
        finally:
            video.release()
