"""Suffixes of the files that are recognised by these, without their readers."""

from __future__ import annotations

from typing import Final

RECORDINGS: Final = (".bag", ".db3", ".mcap")
"""Of ROS recordings."""
VIDEOS: Final = (".mp4", ".avi", ".mkv", ".mov")
MESHES: Final = (".stl", ".obj", ".dae", ".ply")
