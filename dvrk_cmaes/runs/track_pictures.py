"""The frames of a followed recording with their poses, for all that is made of them: video, page, Rerun."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.draw.track_overlay import draw_track
from dvrk_cmaes.export.rerun_file import rerun_file
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.video_writer import whole_video
from dvrk_cmaes.report.track_page import FollowedRecording, TrackPictures, write_track_page
from dvrk_cmaes.results.track_files import VIDEO
from dvrk_cmaes.results.tracked import TrackView
from dvrk_cmaes.runs.track_frames import TrackRun, files_of_views, read_arrays
from dvrk_cmaes.silhouette import Body, Renderer


class SeenFrame(NamedTuple):
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
    run: TrackRun,
    rows: Sequence[Mapping[str, Any]],
    readings: Mapping[str, Float64],
    calibration: SessionCalibration | None,
    *,
    video: bool,
    page: bool,
    rerun: Path | None,
) -> None:
    """Read all followed frames once, and write the overlay video and the page, and a recording for the Rerun viewer.

    Parameters
    ----------
    run
        The run, whose folder has the video and the page.
    rows, readings, calibration
        What is known of all frames: rows of tracks.jsonl, the readings of each joint, the calibration.
    video, page
        Whether to write them.
    rerun
        Path of a recording for the Rerun viewer, or None.

    Raises
    ------
    InputError
        A frame's file cannot be read, or a file cannot be written.
    DvrkCmaesError
        OpenCV cannot encode the video; rerun-sdk is not installed.
    """
    rig, instrument, name = run.session.rig, run.body.instrument, run.session.folder.resolve().name
    pictures, log, writer = TrackPictures(rows) if page else None, None, None
    with ExitStack() as opened:
        if video:
            writer = opened.enter_context(whole_video(run.out / VIDEO, size_of_views(rig), run.frames_a_second))
        if rerun is not None:
            log = opened.enter_context(rerun_file(rerun, rig, instrument, name))
        for number, (row, views) in enumerate(seen_frames(run.frames, rows, rig, run.body)):
            if writer is not None:
                writer.write(draw_track(views, frame=row["frame"], status=row["status"], reasons=row["reasons"]))
            if pictures is not None:
                pictures.add(number, views)
            if log is not None:
                read = {joint: float(values[number]) for joint, values in readings.items()}
                log.add(number, row, read, views)
    if pictures is not None:
        of_page = name, instrument.name, calibration, readings, pictures.overlaps, pictures.pictures
        write_track_page(run.out, FollowedRecording(rows, *of_page, video=VIDEO if video else ""))
