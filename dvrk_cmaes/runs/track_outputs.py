"""What is made of a followed recording: overlay video, page, Rerun; of several arms one video, and exchanged tools."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.draw.track_overlay import draw_track, draw_track_of_arms, project_visible, projected_axes
from dvrk_cmaes.export.rerun_file import rerun_file
from dvrk_cmaes.geometry import Float64, apply
from dvrk_cmaes.io.video_writer import whole_video
from dvrk_cmaes.report.track_page import FollowedRecording, write_track_page
from dvrk_cmaes.results.followed import result_of_row
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import VIDEO, TrackView
from dvrk_cmaes.runs.agreement import exchanged_arms
from dvrk_cmaes.runs.track_inputs import files_of_views, read_arrays
from dvrk_cmaes.silhouette import Renderer

if TYPE_CHECKING:
    from dvrk_cmaes.runs.track import TrackedArm


class SeenFrame(NamedTuple):
    """A frame and its line of tracks.jsonl, with image, mask and silhouette of the pose in each view of the rig."""

    row: Mapping[str, Any]
    views: tuple[TrackView, ...]


def _seen_frames(arm: TrackedArm) -> Iterator[SeenFrame]:
    """Read the frames of an arm that was followed, and render their poses; InputError for a file that is wrong."""
    rig, body = arm.session.rig, arm.body
    renderers = [Renderer(body, view.camera, threads=1) for view in rig.views]
    names = body.instrument.joint_names
    for files, row in zip(arm.frames, arm.rows, strict=True):
        of_views = files_of_views(files, rig)
        views = []
        for number, (view, renderer) in enumerate(zip(rig.views, renderers, strict=True)):
            camera, silhouette, posed = view.camera, None, dict[str, Float64]()
            image, mask, _ = read_arrays(of_views[view.name], camera) if view.name in of_views else (None, None, None)
            if row["camera_from_root"] is not None:
                joints = np.array([[row["joints"][name] for name in names]])
                pose = np.array(row["camera_from_root"])
                seen = view.view_from_camera @ pose if number else pose
                posed["axes"] = projected_axes(camera, seen)
                posed["tips"] = project_visible(camera, apply(seen, body.instrument.ends(joints[0])))
                silhouette = renderer.masks(seen[None], joints)[0]
            views.append(TrackView(image, mask, silhouette, (camera.width, camera.height), **posed))
        yield SeenFrame(row, tuple(views))


def _size_of_views(rig: Rig) -> tuple[int, int]:
    """Return width and height, px, of the views of a rig side by side."""
    cameras = [view.camera for view in rig.views]
    return sum(camera.width for camera in cameras), max(camera.height for camera in cameras)


def write_outputs(arm: TrackedArm) -> None:
    """Read all frames of an arm that was followed, and write video, page, and the file for Rerun, those that are asked.

    Raises
    ------
    InputError
        A frame's file cannot be read, or a file cannot be written.
    DvrkCmaesError
        OpenCV cannot encode the video; rerun-sdk is not installed.
    """
    settings, rows, readings = arm.settings, arm.rows, arm.readings
    if not (settings.video or settings.page or settings.rerun is not None):
        return
    rig, instrument, name = arm.session.rig, arm.body.instrument, arm.session.folder.resolve().name
    page, log, writer = None, None, None
    if settings.page:
        video = VIDEO if settings.video else ""
        alerts = arm.session.warnings
        page = FollowedRecording(rows, name, instrument.name, arm.calibration, readings, video=video, warnings=alerts)
    with ExitStack() as opened:
        if settings.video:
            writer = opened.enter_context(whole_video(arm.out / VIDEO, _size_of_views(rig), arm.frames_a_second))
        if settings.rerun is not None:
            log = opened.enter_context(rerun_file(settings.rerun, rig, instrument, name))
        for number, (row, views) in enumerate(_seen_frames(arm)):
            if writer is not None:
                writer.write(draw_track(views, frame=row["frame"], status=row["status"], reasons=row["reasons"]))
            if page is not None:
                page.add(number, views)
            if log is not None:
                read = {joint: float(values[number]) for joint, values in readings.items()}
                log.add(number, row, read, views)
    if page is not None:
        write_track_page(arm.out, page)


def write_track_arms(out: Path, arms: Mapping[str, TrackedArm]) -> None:
    """Write OUT/tracks.mp4 of arms that were followed; errors as of `write_outputs`."""
    first = next(iter(arms.values()))
    rig, seen = first.session.rig, {name: _seen_frames(arm) for name, arm in arms.items()}
    with whole_video(out / VIDEO, _size_of_views(rig), first.frames_a_second) as writer:
        for frame, shown in _together(seen):
            statuses = {arm: str(seen_frame.row["status"]) for arm, seen_frame in shown.items()}
            views = [{arm: seen_frame.views[k] for arm, seen_frame in shown.items()} for k in range(len(rig.views))]
            writer.write(draw_track_of_arms(views, frame=frame, statuses=statuses, order=_from_far(shown)))


def exchanged_while_followed(arms: Mapping[str, TrackedArm]) -> list[str]:
    """Say which arms that were followed seem to be exchanged: from which frame on, or in all."""
    found: dict[str, dict[str, Result]] = {name: {} for name in arms}
    for name, arm in arms.items():
        for number, row in enumerate(arm.rows):
            read = {joint: float(v[number]) for joint, v in arm.readings.items() if np.isfinite(v[number])}
            found[name][row["frame"]] = replace(result_of_row(name, row), readings=read)
    return exchanged_arms(found, followed=True)


def _together(seen: Mapping[str, Iterator[SeenFrame]]) -> Iterator[tuple[str, dict[str, SeenFrame]]]:
    """Yield the names of the frames in order, with the arms that have them."""
    waiting = {arm: next(frames, None) for arm, frames in seen.items()}
    while any(waiting.values()):
        frame = min(str(seen_frame.row["frame"]) for seen_frame in waiting.values() if seen_frame is not None)
        arms = {arm: each for arm, each in waiting.items() if each is not None and each.row["frame"] == frame}
        yield frame, arms
        waiting |= {arm: next(seen[arm], None) for arm in arms}


def _from_far(arms: Mapping[str, SeenFrame]) -> Sequence[str]:
    """Return the arms from that whose root is farthest from the camera to the nearest, those without a pose first."""

    def distance(arm: str) -> float:
        pose = arms[arm].row["camera_from_root"]
        return np.inf if pose is None else float(np.linalg.norm(np.array(pose)[:3, 3]))

    return sorted(arms, key=distance, reverse=True)
