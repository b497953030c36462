"""The readings of one frame, by joint name, from a file or a text."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from dvrk_cmaes.joints.reading import read_frame_joints
from dvrk_cmaes.joints.rows import ReadAs


def read_joints(source: str | Path, *, frame: str | None = None, known: Iterable[str] = ()) -> dict[str, float]:
    """Read the joints of a frame, or of the only one."""
    return read_frame_joints([source], frame=frame, image="image", read_as=ReadAs(known=tuple(known)))[0]
