"""The dVRK's file suj-fixed.json: the poses at which set-up joints hold the arms, all in one frame."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from msgspec import Struct

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.json_file import json_text, read_json_object
from dvrk_cmaes.io.typed_document import Transform, convert_document

SETUP: Final = "suj-fixed.json"
"""Name of the file."""


class _HeldArm(Struct):
    name: str
    measured_cp: Transform


class _SetupJoints(Struct):
    arms: tuple[_HeldArm, ...]


def read_setup_joints(path: Path) -> dict[str, Float64]:
    """Read the poses (4, 4), m, of the arms' bases in the set-up joints' frame, by name; none without the file.

    Raises
    ------
    InputError
        The file is not valid; the message names it and the field.
    """
    if not path.is_file():
        return {}
    document = read_json_object(path, expected="fixed set-up joints (arms with name and measured_cp)", comments=True)
    return {arm.name: arm.measured_cp for arm in convert_document(str(path), document, _SetupJoints).arms}


def setup_text(poses: Mapping[str, Float64]) -> str:
    """Return the text of the file with the poses (4, 4), m, of arms by name; 0.0 stands for -0.0."""
    return json_text({"arms": [{"name": name, "measured_cp": (pose + 0.0).tolist()} for name, pose in poses.items()]})
