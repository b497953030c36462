"""``dvrk-cmaes import``: a ROS recording, or a video and its readings, to a session folder."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from dvrk_cmaes.cli.options import OUTPUT, Flag
from dvrk_cmaes.cli.terminal import Line, show, warn
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from dvrk_cmaes.recording.recording import Recording
    from dvrk_cmaes.recording.write_session import ImportSummary

SELECTION = Group.create_ordered("Selection")
TOPICS = Group.create_ordered("ROS recording")
VIDEO = Group.create_ordered("Video")


@Parameter(name="*", group=TOPICS)
@dataclass(frozen=True, kw_only=True)
class TopicOptions:
    """Topics of a ROS recording. They are found by type and name; where several would do, say which.

    Parameters
    ----------
    image_topic
        sensor_msgs/Image or CompressedImage.
    camera_topic
        sensor_msgs/CameraInfo; camera_info beside the images unless given.
    joints_topic
        sensor_msgs/JointState of the arm: measured_js or state_joint_current unless given; none to go without.
    jaw_topic
        sensor_msgs/JointState of the jaw: jaw/measured_js or state_jaw_current beside the arm's unless given; or none.
    recorded_times
        Take the times at which messages were recorded, not those in their headers.
    """

    image_topic: str | None = None
    camera_topic: str | None = None
    joints_topic: str | None = None
    jaw_topic: str | None = None
    recorded_times: Flag = False


_DEFAULT_TOPICS = TopicOptions()


def import_recording(
    recording: Path,
    /,
    *,
    out: Annotated[Path, Parameter(group=OUTPUT)],
    every: Annotated[int, Parameter(group=SELECTION)] = 1,
    start: Annotated[float, Parameter(group=SELECTION)] = 0.0,
    end: Annotated[float, Parameter(group=SELECTION)] = math.inf,
    tolerance: Annotated[float, Parameter(group=SELECTION)] = 0.05,
    camera: Annotated[Path | None, Parameter(group=VIDEO)] = None,
    joints: Annotated[Path | None, Parameter(group=VIDEO)] = None,
    video_start: Annotated[float, Parameter(group=VIDEO)] = 0.0,
    topics: TopicOptions = _DEFAULT_TOPICS,
    overwrite: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Make a session folder of a ROS recording (no ROS needed), or of a video and its joint readings.

    Readings are interpolated to the images' times, never extrapolated. The session has images, but no masks yet.

    Examples
    --------
    `dvrk-cmaes import suturing.bag --out session --every 10`

    `dvrk-cmaes import suturing.mp4 --camera camera.yaml --joints joints.csv --video-start 12.4 --out session`

    Parameters
    ----------
    recording
        A ROS 1 .bag, a ROS 2 folder (or its .mcap or .db3 file), or any video that OpenCV reads.
    out
        The session folder to write; it must be new or empty.
    every
        Take every Nth image.
    start
        Seconds after the first image at which to begin.
    end
        Seconds after the first image at which to end.
    tolerance
        How far, in seconds, the readings before and after an image may be from it; beyond, it gets none.
    camera
        The camera file; of a ROS recording, instead of its camera_info.
    joints
        Readings with times, e.g. CSV with a column time (s); of a ROS recording, instead of its topics.
    video_start
        The video's start on the clock of the readings, in seconds.
    topics
        Which topics.
    overwrite
        Replace an older session folder, all of it.
    json
        Print a summary as JSON, and nothing else, on stdout.
    """
    if every < 1:
        raise InputError(f"--every: expected a whole number of at least 1, got {every}")
    if not 0 < tolerance < math.inf:
        raise InputError(f"--tolerance: expected a time in seconds above 0, got {tolerance:g}")
    if not (0 <= start < end):
        raise InputError(f"--start, --end: expected 0 <= start < end in seconds, got {start:g} and {end:g}")
    if not math.isfinite(video_start):
        raise InputError(f"--video-start: expected a finite number of seconds, got {video_start:g}")
    from dvrk_cmaes.io.atomic import json_text
    from dvrk_cmaes.recording.write_session import Selection, write_session

    with _opened(recording, topics, camera, joints, video_start) as opened:
        summary = write_session(
            _with_progress(opened),
            out,
            selection=Selection(every, start, end),
            tolerance=tolerance,
            overwrite=overwrite,
        )
    for one in summary.readings:
        if one.without:
            warn(f"{one.source}: {one.without} of {summary.frames} frames have no readings within {tolerance:g} s")
    if json:
        print(json_text(summary.to_dict()), end="")
    else:
        show(_lines(summary))
    return 0


def _opened(
    path: Path, topics: TopicOptions, camera: Path | None, joints: Path | None, video_start: float
) -> AbstractContextManager[Recording]:
    """Open a recording of whichever kind it is."""
    from dvrk_cmaes.recording.bag import SUFFIXES, open_bag
    from dvrk_cmaes.recording.topics import TopicChoice
    from dvrk_cmaes.recording.video import open_video

    if path.is_dir() or path.suffix.lower() in SUFFIXES:
        asked = TopicChoice(topics.image_topic, topics.camera_topic, topics.joints_topic, topics.jaw_topic)
        return open_bag(path, asked, recorded_times=topics.recorded_times, camera=camera, joints=joints)
    if topics != _DEFAULT_TOPICS:
        raise InputError(f"{path}: topics were asked for; expected a ROS recording ({', '.join(SUFFIXES)} or a folder)")
    return open_video(path, camera=camera, joints=joints, start=video_start)


def _with_progress(recording: Recording) -> Recording:
    """Show a bar on stderr, if that is a terminal, as the images go by."""
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    images: Iterator = iter(  # type: ignore[type-arg]
        track(recording.images, "Importing", recording.total, console=console, disable=not console.is_terminal)
    )
    return replace(recording, images=images)


def _lines(summary: ImportSummary) -> Iterator[Line]:
    """Say what was found, what was decided, and how near the readings were."""
    width, height = summary.size
    yield Line(f"{summary.frames} frames of {summary.images} images, {width} x {height}", "bold")
    for note in summary.notes:
        yield Line(f"  {note}")
    for one in summary.readings:
        far = "" if one.farthest_s is None else f", from readings at most {1e3 * one.farthest_s:.1f} ms away"
        yield Line(f"  {one.source}: {one.frames} frames with readings, {one.without} without{far}")
    yield Line(f"written: {summary.session}")
