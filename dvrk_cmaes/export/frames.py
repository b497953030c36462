"""Names of coordinate frames in exported files."""

from __future__ import annotations

from dataclasses import dataclass

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import shown


@dataclass(frozen=True)
class FrameNames:
    """Names of the arm, of the camera's optical frame (x right, y down, z forward) and of the arm's base frame.

    Raises
    ------
    InputError
        A name is empty or contains a blank or a control character, or the arm's name contains a slash.
    """

    arm: str = "PSM1"
    camera: str = "camera"
    base: str = "PSM1_base"

    def __post_init__(self) -> None:
        for option, name in (("--arm", self.arm), ("--camera-frame", self.camera), ("--base-frame", self.base)):
            if not name or not name.isprintable() or any(letter.isspace() for letter in name):
                raise InputError(f"{option}: expected a name without blanks, got {shown(name)}")
        if "/" in self.arm or self.arm.startswith("."):
            raise InputError(f"--arm: expected a name that can begin a file's, e.g. PSM1, got {shown(self.arm)}")

    def check_tf(self) -> None:
        """Raise InputError for a name that begins with a slash, which tf2 does not accept."""
        for option, name in (("--camera-frame", self.camera), ("--base-frame", self.base)):
            if name.startswith("/"):
                raise InputError(f"{option}: expected a name as tf2 knows them, without a leading slash, got {name!r}")
