"""What the followed arms of a recording have in common: a video with all tools, and exchanged tools."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from dvrk_cmaes.draw.track_overlay import draw_track_of_arms
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.video_writer import whole_video
from dvrk_cmaes.results.track_files import TRACKS, VIDEO, read_tracks
from dvrk_cmaes.runs.exchanged_tools import ArmInSession, FoundFrame, exchanged_arms
from dvrk_cmaes.runs.track_pictures import SeenFrame, seen_frames, size_of_views


def write_track_arms(out: Path, arms: Mapping[str, ArmInSession], frames_a_second: float) -> None:
    """Write OUT/tracks.mp4 of arms whose results are in OUT/ARM.

    Parameters
    ----------
    out
        Folder of the results of all arms.
    arms
        The frames in which each arm was followed, and the arms' instruments, by arm.
    frames_a_second
        Those of the video.

    Raises
    ------
    InputError
        A file cannot be read or written.
    DvrkCmaesError
        OpenCV cannot encode the video.
    """
    rows = {arm: read_tracks(out / arm / TRACKS) for arm in arms}
    rig = next(iter(arms.values())).session.rig
    seen = {name: seen_frames(arm.session.frames, rows[name], rig, arm.body) for name, arm in arms.items()}
    with whole_video(out / VIDEO, size_of_views(rig), frames_a_second) as writer:
        for frame, shown in _together(seen):
            statuses = {arm: str(seen_frame.row["status"]) for arm, seen_frame in shown.items()}
            views = [{arm: seen_frame.views[k] for arm, seen_frame in shown.items()} for k in range(len(rig.views))]
            writer.write(draw_track_of_arms(views, frame=frame, statuses=statuses, order=_from_far(shown)))


def exchanged_while_followed(out: Path, readings: Mapping[str, Mapping[str, Float64]]) -> list[str]:
    """Say which arms, whose results are in OUT/ARM, seem to be exchanged: from which frame on, or in all.

    Parameters
    ----------
    out
        Folder of the results of all arms.
    readings
        By arm and joint, those of each followed frame, NaN where there is none.

    Raises
    ------
    InputError
        A file of results cannot be read.
    """
    found: dict[str, dict[str, FoundFrame]] = {arm: {} for arm in readings}
    for arm, of_joints in readings.items():
        for number, row in enumerate(read_tracks(out / arm / TRACKS)):
            read = {name: float(v[number]) for name, v in of_joints.items() if np.isfinite(v[number])}
            joints = {} if row["camera_from_root"] is None else row["joints"]
            found[arm][row["frame"]] = FoundFrame(joints, read, row["status"] == "ok")
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
