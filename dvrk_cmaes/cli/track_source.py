"""What ``dvrk-cmaes track`` follows: a session folder, a video, or a ROS recording, as a session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import no_folder

if TYPE_CHECKING:
    from dvrk_cmaes.cli.options import CameraOptions
    from dvrk_cmaes.cli.session_tools import SessionTool
    from dvrk_cmaes.runs.agreement import ArmInSession

_IMPORTED = "session"
_TOLERANCE = 0.05  # s, as of import


@dataclass(frozen=True)
class Source:
    """What is followed: the session ``folder``, and the ``video`` with its images, None if these are files."""

    folder: Path
    video: Path | None = None

    @staticmethod
    def of(path: Path, evidence: str | None, out: Path, *, camera: Path | None, joints: Path | None) -> Source:
        """Find the session of a path; that of a ROS recording is written to a folder in ``out``.

        The video of a session counts where it has no images, and its masks are not all that is asked for.

        Raises
        ------
        InputError
            There is nothing at the path, or it is neither; it holds links that leave it.
        """
        from dvrk_cmaes.frames.own_files import OwnFiles
        from dvrk_cmaes.frames.session_video import own_video
        from dvrk_cmaes.frames.video_frames import SUFFIXES
        from dvrk_cmaes.recording.topics import is_bag

        if path.suffix.lower() in SUFFIXES and not path.is_dir():
            return Source(path.parent, path)
        if is_bag(path):
            OwnFiles(path).check_folder()
            return Source(_imported(path, out / _IMPORTED, camera, joints))
        if not path.is_dir():
            raise InputError(f"{path}: {no_folder(path)}; expected a session folder, a video or a ROS recording")
        needed = evidence == "images" or not (path / "masks").is_dir()
        video = own_video(path) if needed else None
        OwnFiles(path).check_all([video])
        return Source(path, video)

    def read(
        self, tool: SessionTool, camera: CameraOptions, *, joints: Sequence[Path] | None, ahead: bool
    ) -> ArmInSession:
        """Read the session of a tool."""
        from dvrk_cmaes.frames.session_video import SessionVideo

        opened = None if self.video is None else SessionVideo.open(self.video, layout=None, side=camera.side, start=0)
        return tool.read(self.folder, camera, joints=joints, video=opened, ahead=ahead)


def _imported(path: Path, folder: Path, camera: Path | None, joints: Path | None) -> Path:
    """Write the session of a ROS recording, in place of an earlier one; returns its folder."""
    from dvrk_cmaes.recording.bag import open_bag
    from dvrk_cmaes.recording.recording import Asked
    from dvrk_cmaes.recording.topics import TopicRequest
    from dvrk_cmaes.recording.write_session import ImageSelection, write_session

    with open_bag(path, TopicRequest(), Asked(camera=camera, joints=joints)) as recording:
        write_session(recording, folder, selection=ImageSelection(), tolerance=_TOLERANCE, overwrite=folder.exists())
    return folder
