"""Result and options of an inspection, and suffixes by which files are recognised without their readers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.camera.fields import Side
from dvrk_cmaes.joints.rows import BY_THEMSELVES, ReadAs

RECORDINGS: Final = (".bag", ".db3", ".mcap")
"""Of ROS recordings."""
VIDEOS: Final = (".mp4", ".avi", ".mkv", ".mov")
MESHES: Final = (".stl", ".obj", ".dae", ".ply")


@dataclass(frozen=True)
class Finding:
    """Result of the inspection of one file or folder.

    Parameters
    ----------
    kind
        Name of the recognised format.
    lines
        The content as text, in mm and degrees.
    read
        The content as plain values for JSON, in m and rad.
    notes
        The rules applied where the content is ambiguous.
    """

    kind: str
    lines: tuple[str, ...]
    read: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as plain values for JSON."""
        return {"kind": self.kind, "in_words": list(self.lines), "read": self.read, "notes": list(self.notes)}


@dataclass(frozen=True)
class Options:
    """Options for reading ambiguous files, with the meaning of the same options of the other commands."""

    rectified: bool = False
    side: Side = "left"
    package_paths: Mapping[str, Path] = field(default_factory=dict)
    camera: Path | None = None
    read_as: ReadAs = BY_THEMSELVES


def unit_of(joint: str) -> tuple[float, str]:
    """Return the factor from m or rad to the unit in which a joint is described, and that unit, mm or deg."""
    return (1e3, "mm") if joint.endswith("insertion") else (180 / math.pi, "deg")


def counted(number: int, what: str) -> str:
    """Format a number with a noun, in the plural unless the number is one."""
    return f"{number} {what}{'' if number == 1 else 's'}"
