"""The table of readers of recordings: how each kind is known, what opens it, and what can be asked of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.recording.bag import open_bag
from dvrk_cmaes.recording.lerobot import is_lerobot, open_lerobot
from dvrk_cmaes.recording.recording import Asked, Recording
from dvrk_cmaes.recording.surgpose import is_surgpose, open_surgpose
from dvrk_cmaes.recording.surgsync import is_packed, is_surgsync, open_packed, open_surgsync
from dvrk_cmaes.recording.topics import is_bag
from dvrk_cmaes.recording.video import SIDES, has_stereo_videos, open_stereo_videos, open_video


class Reader(NamedTuple):
    """A kind of recordings: its name, whether a path is one, what opens it, and the options that it takes, as words."""

    name: str
    knows: Callable[[Path], bool]
    open: Callable[[Path, Asked], Recording]
    takes: str


_TOPICS: Final = "image_topic image_topic_right camera_topic joints_topic jaw_topic recorded_times rectified"

READERS: Final = (
    Reader("a LeRobot data set", is_lerobot, open_lerobot, "arms episode posed"),
    Reader("a folder of SurgPose", is_surgpose, open_surgpose, "arms both"),
    Reader("an episode of SurgSync", is_packed, open_packed, "arms both"),
    Reader("a clip of SurgSync", is_surgsync, open_surgsync, "arms both"),
    Reader("stereo videos", has_stereo_videos, open_stereo_videos, "both start columns"),
    Reader("a ROS recording", is_bag, open_bag, f"arms both {_TOPICS}"),
    Reader("a video", lambda path: True, open_video, "both start layout crop columns"),
)
"""The first that knows a path opens it."""

_OPTIONS: Final = {"arms": "--arm", "both": "--side both", "start": "--video-start", "posed": "--pose-of alone"}
"""How fields of `Asked` are asked for whose options have another name."""


def open_recording(path: Path, asked: Asked) -> Recording:
    """Open a recording of any kind, or the recordings of both eyes, the right one as ``right`` of the left one.

    Raises
    ------
    InputError
        The path is a session, an option is asked for that its kind does not take, or as the kind's reader.
    """
    reader = next(reader for reader in READERS if reader.knows(path))
    if reader.open is open_video and path.is_dir():
        said = "one of pictures or a session needs no import: `dvrk-cmaes batch FOLDER` takes it; this is not"
        raise InputError(
            f"{path}: expected a recording, got a folder: {said} {', '.join(r.name for r in READERS[:-1])}"
        )
    for name in dict.fromkeys(" ".join(other.takes for other in READERS).split()):
        if getattr(asked, name) != getattr(Asked(), name) and name not in reader.takes.split():
            option = _OPTIONS.get(name, f"--{name.replace('_', '-')}")
            able = " or ".join(other.name for other in READERS if name in other.takes.split())
            raise InputError(f"{path}: {option}: expected {able} with it, got {reader.name}")
    if len(asked.arms) > 1 and reader.open is not open_bag:
        raise InputError(f"{path}: --arm: expected one arm, but of a ROS recording, got {', '.join(asked.arms)}")
    if not asked.both:
        return reader.open(path, asked)
    if asked.camera is not None and reader.open is not open_video:
        raise InputError("--camera: expected none with --side both, whose cameras are those of the recording")
    left, right = (reader.open(path, replace(asked, side=side)) for side in SIDES)
    notes = tuple(f"right eye: {note}" for note in right.notes if note.startswith(("images:", "camera:")))
    return replace(left, right=right, notes=(*left.notes, *notes))
