"""Which paths are ROS recordings, told without their reader, which takes long to import."""

from __future__ import annotations

from pathlib import Path

SUFFIXES_2 = (".mcap", ".db3")
SUFFIXES = (".bag", *SUFFIXES_2)
"""Suffixes of ROS recordings; a recording may also be a folder."""


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS recording: a file with its suffix, or a folder with such files that is no session."""
    if not path.is_dir():
        return path.suffix.lower() in SUFFIXES
    from dvrk_cmaes.frames.session_folder import is_session_layout

    if is_session_layout(path):
        return False
    return (path / "metadata.yaml").exists() or any(file.suffix in SUFFIXES_2 for file in path.iterdir())
