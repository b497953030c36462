"""The frames of a followed recording with their poses, for all that is made of them: video, page, Rerun."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.track_overlay import draw_track
from dvrk_cmaes.export.rerun_file import rerun_file
from dvrk_cmaes.frames.frame import FrameFiles, read_frame, read_frame_image
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.video_file import whole_video
from dvrk_cmaes.report.track_page import FollowedRecording, write_track_page
from dvrk_cmaes.report.track_pictures import TrackPictures
from dvrk_cmaes.silhouette import Body, Renderer


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """A frame and its line of tracks.jsonl, with image (H, W, 3) BGR, mask and silhouette of the pose (H, W), or None.

    They have the camera's size.
    """

    row: Mapping[str, Any]
    image: NDArray[np.uint8] | None
    mask: NDArray[np.bool_] | None
    silhouette: NDArray[np.bool_] | None


def seen_frames(
    frames: Sequence[FrameFiles], rows: Sequence[dict[str, Any]], camera: Camera, body: Body
) -> Iterator[SeenFrame]:
    """Read the frames that have the given lines of tracks.jsonl, and render their poses.

    Raises
    ------
    InputError
        A frame's file cannot be read.
    """
    renderer = Renderer(body, camera, threads=1)
    names = body.instrument.joint_names
    size = (camera.width, camera.height)
    for files, row in zip(frames, rows, strict=True):
        image = mask = silhouette = None
        if files.mask is not None:
            data = read_frame(files, camera, blank=True)
            image, mask = data.image, data.mask
        elif files.has_image:
            image = read_frame_image(files, camera).image
        if image is not None and image.shape[1::-1] != size:
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        if row["camera_from_root"] is not None:
            joints = np.array([[row["joints"][name] for name in names]])
            silhouette = renderer.masks(np.array([row["camera_from_root"]]), joints)[0]
        yield SeenFrame(row, image, mask, silhouette)


def write_outputs(
    seen: Iterator[SeenFrame],
    recording: FollowedRecording,
    camera: Camera,
    instrument: Instrument,
    *,
    video: Path | None,
    frames_a_second: float,
    page: Path | None,
    rerun: Path | None,
) -> None:
    """Read all frames once, and write what is made of them.

    Parameters
    ----------
    seen, recording
        The frames, and what is known of all of them; its residuals and pictures are made here.
    camera, instrument
        The camera and the instrument.
    video, frames_a_second
        Path of the overlay video, or None; frames a second of it.
    page
        Folder of the page, or None.
    rerun
        Path of a recording for the Rerun viewer, or None.

    Raises
    ------
    InputError
        A frame's file cannot be read, or a file cannot be written.
    DvrkCmaesError
        OpenCV cannot encode the video; rerun-sdk is not installed.
    """
    size = (camera.width, camera.height)
    pictures = None if page is None else TrackPictures(recording.rows)
    with ExitStack() as opened:
        writer = None if video is None else opened.enter_context(whole_video(video, size, frames_a_second))
        log = None
        if rerun is not None:
            log = opened.enter_context(rerun_file(rerun, camera, instrument, recording.session))
        for number, one in enumerate(seen):
            if writer is not None:
                writer.write(_overlay(one, size))
            if pictures is not None:
                pictures.add(number, one.image, one.mask, one.silhouette, size)
            if log is not None:
                read = {name: float(values[number]) for name, values in recording.readings.items()}
                log.add(number, one.row, read, image=one.image, mask=one.mask, silhouette=one.silhouette)
    if page is not None and pictures is not None:
        write_track_page(page, replace(recording, residuals=pictures.residuals, pictures=pictures.pictures))


def _overlay(one: SeenFrame, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Draw a frame of the overlay video."""
    row = one.row
    return draw_track(
        one.image,
        one.mask,
        one.silhouette,
        frame=row["frame"],
        status=row["status"],
        reasons=row["reasons"],
        size=size,
    )
