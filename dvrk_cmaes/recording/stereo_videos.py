"""Reader of folders with the videos of a stereo endoscope, of which one eye is read.

The folder has a video for each eye, named left and right (``left.mp4``, ``suturing_left.avi``), the cameras left.yaml
and right.yaml or one camera.yaml, and joints.csv.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.video_frames import SUFFIXES
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.recording.recording import Asked, Recording
from dvrk_cmaes.recording.video import open_video

_SIDES: Final[tuple[Side, ...]] = ("left", "right")


def has_stereo_videos(path: Path) -> bool:
    """Whether a folder has a video of each eye."""
    return all(_videos(path, side) for side in _SIDES)


@contextmanager
def open_stereo_videos(path: Path, asked: Asked) -> Iterator[Recording]:
    """Open the video of one eye; camera and joints as in ``open_video``, by default the folder's.

    Raises
    ------
    InputError
        The folder has no video of this eye or several, or as in ``open_video``.
    """
    side, videos = asked.side, _videos(path, asked.side)
    if len(videos) != 1:
        there = f"several: {listed(video.name for video in videos)}" if videos else "none"
        raise InputError(f"{path}: expected one video of the {side} eye, got {there}")
    camera = asked.camera or _first(path, f"{side}.yaml", "camera.yaml")
    asked = replace(asked, camera=camera, joints=asked.joints or _first(path, "joints.csv"))
    with open_video(videos[0], asked) as recording:
        yield replace(recording, path=path, notes=(f"images: {videos[0].name}", *recording.notes))


def _videos(path: Path, side: Side) -> list[Path]:
    """List the videos whose names have a side's name as a word, e.g. ``left``, ``left_eye`` or ``PSM1-left``."""
    return [
        file
        for file in sorted(path.iterdir())
        if file.suffix.lower() in SUFFIXES and side in file.stem.lower().replace("-", "_").replace(".", "_").split("_")
    ]


def _first(path: Path, *names: str) -> Path | None:
    """Return the first of some files that the folder has; None if it has none of them."""
    return next((path / name for name in names if (path / name).exists()), None)
