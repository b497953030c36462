"""Overlay video of a followed recording, drawn from its tracks."""

from __future__ import annotations

import contextlib
import os
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.track_overlay import draw_track
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.frames.frame import FrameFiles, read_frame, read_frame_image
from dvrk_cmaes.io.atomic import not_written
from dvrk_cmaes.silhouette import Body, Renderer


def write_video(
    path: Path,
    frames: Sequence[FrameFiles],
    rows: Sequence[dict[str, Any]],
    camera: Camera,
    body: Body,
    *,
    frames_a_second: float,
) -> None:
    """Write the overlay of each frame, given with its row of tracks.jsonl, as an mp4 file.

    Raises
    ------
    InputError
        A frame's file cannot be read, or the video cannot be written there.
    DvrkCmaesError
        OpenCV cannot encode the video.
    """
    renderer = Renderer(body, camera, threads=1)
    names = body.instrument.joint_names
    size = (camera.width, camera.height)
    with _video(path, size, frames_a_second) as video:
        for files, row in zip(frames, rows, strict=True):
            image = mask = silhouette = None
            if files.mask is not None:
                data = read_frame(files, camera, blank=True)
                image, mask = data.image, data.mask
            elif files.image is not None:
                image = read_frame_image(files, camera).image
            if image is not None and image.shape[1::-1] != size:
                image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
            if row["camera_from_root"] is not None:
                joints = np.array([[row["joints"][name] for name in names]])
                silhouette = renderer.masks(np.array([row["camera_from_root"]]), joints)[0]
            video.write(
                draw_track(
                    image,
                    mask,
                    silhouette,
                    frame=row["frame"],
                    status=row["status"],
                    reasons=row["reasons"],
                    size=size,
                )
            )


@contextmanager
def _video(path: Path, size: tuple[int, int], frames_a_second: float) -> Iterator[Any]:
    """Open a video that is written beside its place and renamed when it is complete."""
    beside = path.with_name(f".{uuid.uuid4().hex}.mp4")
    try:
        video = cv2.VideoWriter(str(beside), cv2.VideoWriter.fourcc(*"mp4v"), frames_a_second, size)
        if not video.isOpened():
            raise DvrkCmaesError(f"{path}: OpenCV cannot write an mp4 video there")
        try:
            yield video
        finally:
            video.release()
        try:
            os.replace(beside, path)
        except OSError as error:
            raise not_written(path, error, "a video") from None
    finally:
        with contextlib.suppress(OSError):
            beside.unlink()
