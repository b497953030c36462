"""Overlay video of a followed recording, drawn from its tracks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.track_overlay import draw_track
from dvrk_cmaes.frames.frame import FrameFiles, read_frame, read_frame_image
from dvrk_cmaes.io.video_file import whole_video
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
    with whole_video(path, size, frames_a_second) as video:
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
