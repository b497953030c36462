"""What was found in one file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dvrk_cmaes.camera.fields import Side


@dataclass(frozen=True)
class Finding:
    """What a file was taken for.

    ``kind`` is a word or two, ``lines`` say what was read, in mm and degrees. ``read`` is the same as plain values
    for JSON, in m and rad. ``notes`` name the rules by which what is ambiguous was decided.
    """

    kind: str
    lines: tuple[str, ...]
    read: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {"kind": self.kind, "in_words": list(self.lines), "read": self.read, "notes": list(self.notes)}


@dataclass(frozen=True)
class Options:
    """How ambiguous files are to be read, as in the other commands' options."""

    rectified: bool = False
    side: Side = "left"
    package_paths: Mapping[str, Path] = field(default_factory=dict)
    camera: Path | None = None


def counted(number: int, what: str) -> str:
    """Say how many there are of something."""
    return f"{number} {what}{'' if number == 1 else 's'}"
