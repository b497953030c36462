"""The video of a session: names and times of its frames, and the part of its picture that is one camera's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.video_frames import Layout, Video, VideoFrame
from dvrk_cmaes.joints.rows import JointFile

_NAME = "video.mp4"
_DIGITS = 6  # of the name of a frame that is only numbered


def own_video(folder: Path) -> Path | None:
    """Return the video of a session folder; None if it has none, or a folder of images."""
    path = folder / _NAME
    return path if path.exists() and not (folder / "images").is_dir() else None


@dataclass(frozen=True, eq=False)
class SessionVideo:
    """A video with the images of a session.

    ``layout`` and ``side`` are those of a stereo picture, as in `Video.window`; ``start`` ns is the time of the first
    frame on the clock of the readings.
    """

    video: Video
    layout: Layout | None = None
    side: Side = "left"
    start: int = 0

    @staticmethod
    def open(path: Path, *, layout: Layout | None = None, side: Side = "left", start: int = 0) -> SessionVideo:
        """Open a video; errors are those of `Video`.

        Parameters
        ----------
        path
            The video.
        layout
            Where its pictures have the two eyes; None for one camera.
        side
            The eye that is read.
        start
            Time of the first image on the clock of the readings, ns.
        """
        return SessionVideo(Video(path), layout, side, start)

    def frames(self, files: Sequence[JointFile], masks: Sequence[str]) -> Mapping[str, VideoFrame]:
        """Return the frames by name: that of their masks, or of their rows in the readings, or else their numbers.

        Parameters
        ----------
        files
            The files of readings.
        masks
            Names of the masks, without suffix.

        Raises
        ------
        InputError
            The readings have rows of named frames, but not one for each frame of the video.
        """
        count = len(self.video.times)
        rows = next((tuple(file.names) for file in files if file.labels == "frame"), None)
        names: Sequence[str] = [f"{number:0{_DIGITS}d}" for number in range(count)]
        if len(masks) == count:
            names = masks
        elif rows is not None:
            if len(rows) != count:
                raise InputError(f"{self.video.path}: expected {len(rows)} frames, as joints.csv has, got {count}")
            names = rows
        window = self.video.window(None, self.layout, self.side)
        return {name: VideoFrame(self.video, number, window) for number, name in enumerate(names)}

    def fitted(self, frames: Sequence[FrameFiles], camera: Camera) -> tuple[FrameFiles, ...]:
        """Return frames with the part of the picture that is one camera's; InputError as in `Video.window`.

        Parameters
        ----------
        frames
            The frames.
        camera
            The camera, which has the size of the part.
        """
        window = self.video.window(camera, self.layout, self.side)
        return tuple(
            files if files.video is None else replace(files, video=replace(files.video, window=window))
            for files in frames
        )
