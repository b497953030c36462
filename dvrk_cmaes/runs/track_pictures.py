"""The frames of a followed recording with their poses, for all that is made of them: video, page, Rerun."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.draw.track_overlay import TrackView, draw_track
from dvrk_cmaes.export.rerun_file import ViewPictures, rerun_file
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.video_writer import whole_video
from dvrk_cmaes.report.track_page import FollowedRecording, write_track_page
from dvrk_cmaes.report.track_pictures import TrackPictures
from dvrk_cmaes.runs.track_frames import files_of_views, read_arrays
from dvrk_cmaes.silhouette import Body, Renderer


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """A frame and its line of tracks.jsonl, with image, mask and silhouette of the pose in each view of the rig."""

    row: Mapping[str, Any]
    views: tuple[TrackView, ...]


def seen_frames(
    frames: Sequence[FrameFiles], rows: Sequence[Mapping[str, Any]], rig: Rig, body: Body
) -> Iterator[SeenFrame]:
    """Read the frames that have the given lines of tracks.jsonl, and render their poses.

    Raises
    ------
    InputError
        A frame's file cannot be read.
    """
    renderers = [Renderer(body, view.camera, threads=1) for view in rig.views]
    names = body.instrument.joint_names
    for files, row in zip(frames, rows, strict=True):
        of_views = files_of_views(files, rig)
        views = []
        for number, (view, renderer) in enumerate(zip(rig.views, renderers, strict=True)):
            camera, silhouette = view.camera, None
            image, mask, _ = read_arrays(of_views[view.name], camera) if view.name in of_views else (None, None, None)
            if row["camera_from_root"] is not None:
                joints = np.array([[row["joints"][name] for name in names]])
                pose = np.array(row["camera_from_root"])
                seen = view.view_from_camera @ pose if number else pose
                silhouette = renderer.masks(seen[None], joints)[0]
            views.append(TrackView(image, mask, silhouette, (camera.width, camera.height)))
        yield SeenFrame(row, tuple(views))


def size_of_views(rig: Rig) -> tuple[int, int]:
    """Return width and height, px, of the views of a rig beside each other."""
    cameras = [view.camera for view in rig.views]
    return sum(camera.width for camera in cameras), max(camera.height for camera in cameras)


def write_outputs(
    seen: Iterator[SeenFrame],
    recording: FollowedRecording,
    rig: Rig,
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
    rig, instrument
        The cameras of all views and the instrument.
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
    size = size_of_views(rig)
    pictures = None if page is None else TrackPictures(recording.rows)
    with ExitStack() as opened:
        writer = None if video is None else opened.enter_context(whole_video(video, size, frames_a_second))
        log = None
        if rerun is not None:
            log = opened.enter_context(rerun_file(rerun, rig, instrument, recording.session))
        for number, one in enumerate(seen):
            if writer is not None:
                row = one.row
                drawn = draw_track(one.views, frame=row["frame"], status=row["status"], reasons=row["reasons"])
                writer.write(drawn)
            if pictures is not None:
                pictures.add(number, one.views)
            if log is not None:
                read = {name: float(values[number]) for name, values in recording.readings.items()}
                views = [ViewPictures(view.image, view.mask, view.silhouette) for view in one.views]
                log.add(number, one.row, read, views)
    if page is not None and pictures is not None:
        write_track_page(page, replace(recording, residuals=pictures.residuals, pictures=pictures.pictures))
