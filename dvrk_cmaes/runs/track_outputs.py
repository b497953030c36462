"""What is made of a followed recording: overlay video, page, Rerun, results; of several arms one video."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.draw.track_overlay import draw_track, draw_track_of_arms, project_visible, projected_axes
from dvrk_cmaes.export.rerun_file import rerun_file
from dvrk_cmaes.geometry import Float64, apply
from dvrk_cmaes.io.short_text import natural
from dvrk_cmaes.io.video_writer import whole_video
from dvrk_cmaes.report.template import write
from dvrk_cmaes.report.track_page import PAGE, FollowedRecording, track_page
from dvrk_cmaes.results.followed import result_of_row
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import VIDEO, TrackView
from dvrk_cmaes.runs.track_inputs import files_of_views, read_arrays
from dvrk_cmaes.silhouette import Renderer

if TYPE_CHECKING:
    from dvrk_cmaes.runs.track import TrackedArm


class _Drawn:
    """The frames of an arm that was followed, as its views show them, with the silhouette of each pose."""

    def __init__(self, arm: TrackedArm) -> None:
        self._arm, self.rig = arm, arm.session.rig
        self._renderers = [Renderer(arm.body, view.camera, threads=1) for view in self.rig.views]

    def views(self, number: int) -> tuple[TrackView, ...]:
        """Read a frame, and render its pose in each view of the rig; InputError for a file that is wrong."""
        row, instrument = self._arm.rows[number], self._arm.body.instrument
        of_views, found = files_of_views(self._arm.recorded.files[number], self.rig), []
        for first, (view, renderer) in enumerate(zip(self.rig.views, self._renderers, strict=True)):
            camera, silhouette, posed = view.camera, None, dict[str, Float64]()
            image, mask, _ = read_arrays(of_views[view.name], camera) if view.name in of_views else (None, None, None)
            if row["camera_from_root"] is not None:
                joints = np.array([row["joints"][name] for name in instrument.joint_names])
                pose = np.array(row["camera_from_root"])
                seen = view.view_from_camera @ pose if first else pose
                posed["axes"] = projected_axes(camera, seen)
                posed["tips"] = project_visible(camera, apply(seen, instrument.ends(joints)))
                silhouette = renderer.masks(seen[None], joints[None])[0]
            found.append(TrackView(image, mask, silhouette, (camera.width, camera.height), **posed))
        return tuple(found)


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
    settings, instrument, name = arm.settings, arm.body.instrument, arm.session.folder.resolve().name
    embedded, alerts = VIDEO if settings.video else "", arm.session.warnings
    page = FollowedRecording(
        arm.rows, name, instrument.name, arm.calibration, arm.readings, video=embedded, warnings=alerts
    )
    rig, drawn, video, log = arm.session.rig, _Drawn(arm), None, None
    with ExitStack() as opened:
        if settings.video:
            video = opened.enter_context(whole_video(arm.out / VIDEO, _size_of_views(rig), arm.frames_a_second))
        if settings.rerun is not None:
            log = opened.enter_context(rerun_file(settings.rerun, rig, instrument, name))
        for number, row in enumerate(arm.rows if settings.video or settings.page or settings.rerun else ()):
            views = drawn.views(number)
            if video is not None:
                video.write(draw_track(views, frame=row["frame"], status=row["status"], reasons=row["reasons"]))
            if settings.page:
                page.add(number, views)
            if log is not None:
                log.add(number, row, {joint: float(v[number]) for joint, v in arm.readings.items()}, views)
    if settings.page:
        write(arm.out / PAGE, track_page(page))


def write_track_arms(out: Path, arms: Mapping[str, TrackedArm]) -> None:
    """Write OUT/tracks.mp4 of arms that were followed; errors as of `write_outputs`."""
    first, drawn = next(iter(arms.values())), {name: _Drawn(arm) for name, arm in arms.items()}
    rows = {name: {row["frame"]: (k, row) for k, row in enumerate(arm.rows)} for name, arm in arms.items()}
    with whole_video(out / VIDEO, _size_of_views(first.session.rig), first.frames_a_second) as writer:
        for frame in sorted(set().union(*rows.values()), key=natural):
            there = {name: of_arm[frame] for name, of_arm in rows.items() if frame in of_arm}
            shown = {name: drawn[name].views(k) for name, (k, _) in there.items()}
            views = [dict(zip(shown, of_arms, strict=True)) for of_arms in zip(*shown.values(), strict=True)]
            statuses = {name: row["status"] for name, (_, row) in there.items()}
            order = sorted(there, key=lambda name: _distance(there[name][1]), reverse=True)
            writer.write(draw_track_of_arms(views, frame=frame, statuses=statuses, order=order))


def followed_results(arm: TrackedArm) -> dict[str, Result]:
    """Return the frames of an arm that was followed as results, with their readings, by name."""
    found = {}
    for number, row in enumerate(arm.rows):
        read = {joint: float(v[number]) for joint, v in arm.readings.items() if np.isfinite(v[number])}
        found[row["frame"]] = replace(result_of_row(row["frame"], row), readings=read)
    return found


def _distance(row: Mapping[str, Any]) -> float:
    """Return the distance of a row's root from the camera, m; infinite without a pose."""
    pose = row["camera_from_root"]
    return np.inf if pose is None else float(np.linalg.norm(np.array(pose)[:3, 3]))
