"""Readers of the JSON files of one frame of a SurgSync clip: its times, and the readings of an arm.

The online and the offline recorder nest the fields differently (e.g. ``jaw`` beside ``arm`` or inside it), so that a
field is searched for by its name, at the outermost level first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.json_file import read_json
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.names import ECM_JOINTS, joint_reading, joints_by_count
from dvrk_cmaes.joints.times import parse_time

_TIMES = "the times of a frame (time_syn, JSON)"
_KINEMATICS = "the readings of an arm (kinematic, JSON)"
_SECONDS = ("sec", "secs")
_NANOSECONDS = ("nsec", "nanosec", "nsecs")


@dataclass(frozen=True)
class FrameTimes:
    """Times of a frame's image and, where they are stated, of the readings of the arm and of its jaw, ns."""

    image: int
    arm: int | None = None
    jaw: int | None = None


def read_times(path: Path, side: Side, arm: str | None) -> FrameTimes:
    """Read ``time_syn/N.json``, for one camera's image and one arm's readings.

    Raises
    ------
    InputError
        The file is not readable or states no time of the image; the message names it and the field.
    """
    document = read_json(path, expected=_TIMES)
    image = _time(str(path), document, f"image_{side}_stamp", f"image_{side}", side, "timestamp")
    if image is None:
        raise InputError(f"{path}: image_{side}_stamp: expected the image's time (sec, nsec), got none")
    of_arm = None if arm is None else _field(document, arm)
    jaw = _field(of_arm, "jaw")
    return FrameTimes(
        image,
        _time(str(path), of_arm, "measured_js_stamp", "measured_js"),
        _time(str(path), jaw, "measured_stamp", "measured_js_stamp", "measured_js"),
    )


def read_positions(path: Path) -> dict[str, float]:
    """Read ``kinematic/ARM/N.json``: the positions of the arm's joints and, where it is stated, of its jaw, rad or m.

    Raises
    ------
    InputError
        The file is not readable, or has no measured_js, or one of another number of joints, or a wrong number.
    """
    where, (document, values) = str(path), _measured(path)
    if values is None:
        raise InputError(f"{path}: measured_js: expected an object with position, a list of numbers, got none")
    cells = dict(zip(joints_by_count(f"{where}: measured_js", len(values)), values, strict=True))
    jaw = _field(document, "jaw")
    opening = _position(_field(jaw, "measured_data") or _field(jaw, "measured_js") or jaw)
    if opening:
        cells["jaw"] = opening[0]
    return {name: joint_reading(where, name, cell) for name, cell in cells.items()}


def read_ecm(path: Path) -> dict[str, float]:
    """Read ``kinematic/ECM/N.json``: the joints of the endoscope's arm, rad or m; errors as `read_positions`."""
    _, values = _measured(path)
    if values is None or len(values) != len(ECM_JOINTS):
        got = "none" if values is None else f"{len(values)} of them"
        raise InputError(f"{path}: measured_js: expected the positions of {', '.join(ECM_JOINTS)}, got {got}")
    return {name: joint_reading(str(path), name, cell) for name, cell in zip(ECM_JOINTS, values, strict=True)}


def _measured(path: Path) -> tuple[Any, list[Any] | None]:
    """Read the readings of an arm: the document, and the measured positions in it; None without any."""
    document = read_json(path, expected=_KINEMATICS)
    measured = _field(document, "measured_data") or document
    return document, _position(_field(measured, "measured_js") or _field(measured, "js"))


def _field(document: Any, name: str) -> Any:
    """Return the outermost value of a name in nested objects and lists; None if there is none."""
    level = [document]
    while level:
        for value in level:
            if isinstance(value, dict) and name in value:
                return value[name]
        nested = (
            value.values() if isinstance(value, dict) else value for value in level if isinstance(value, dict | list)
        )
        level = [inner for values in nested for inner in values]
    return None


def _position(value: Any) -> list[Any] | None:
    """Return the list of positions of a JointState, or a list as it is; None for other values."""
    position = value.get("position") if isinstance(value, dict) else value
    return position if isinstance(position, list) else None


def _time(where: str, document: Any, *names: str) -> int | None:
    """Return the time, ns, under the first of some names that has one; None if none has, or it is zero."""
    for name in names:
        value = _field(document, name)
        seconds, rest = (_of(value, keys) for keys in (_SECONDS, _NANOSECONDS))
        if seconds is not None and rest is not None:
            if not all(isinstance(part, int) and not isinstance(part, bool) for part in (seconds, rest)):
                raise InputError(f"{where}: {name}: expected whole seconds and nanoseconds, got {shown(value)}")
            return int(seconds) * NANOSECONDS + int(rest) or None
        if isinstance(value, str | int | float) and not isinstance(value, bool):
            # the name of the recorder's folder, SECONDS_NANOSECONDS, without leading zeros
            first, underscore, last = str(value).partition("_")
            return parse_time(f"{where}: {name}", f"{first}.{last:0>9}" if underscore else value)
    return None


def _of(value: Any, keys: tuple[str, ...]) -> Any:
    """Return the value of the first key that an object has; None if it has none or is no object."""
    return next((value[key] for key in keys if key in value), None) if isinstance(value, dict) else None
