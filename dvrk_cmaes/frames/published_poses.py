"""Read published.csv: the poses that the paper's authors published, one row per frame.

The columns are ``frame, rx, ry, rz`` (axis-angle, rad), ``tx, ty, tz`` (m) of camera_from_root, and the joints
``wrist_pitch, wrist_yaw, jaw_2, jaw_1`` (rad). Each jaw has an angle of its own: the opening is the sum of the two, and
half of their difference is added to the wrist's yaw.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, exp_rotation, transform
from dvrk_cmaes.io.csv_file import number_in, read_csv_rows
from dvrk_cmaes.io.short_text import listed, shown

_EXPECTED: Final = "published poses (published.csv)"
_ROTATION: Final = ("rx", "ry", "rz")
_TRANSLATION: Final = ("tx", "ty", "tz")
_JOINTS: Final = ("wrist_pitch", "wrist_yaw", "jaw_2", "jaw_1")
_COLUMNS: Final = ("frame", *_ROTATION, *_TRANSLATION, *_JOINTS)


def read_published_poses(path: str | Path) -> dict[str, tuple[Float64, dict[str, float]]]:
    """Read a published.csv, by frame, in the order of its rows.

    Each frame has its ``camera_from_root`` (4, 4), m, and its joints wrist_pitch, wrist_yaw, jaw by name, rad.

    Raises
    ------
    InputError
        Naming the file, the line and the column, and what was expected.
    """
    header, rows = read_csv_rows(path, expected=_EXPECTED)
    missing = [name for name in _COLUMNS if name not in header]
    if missing:
        raise InputError(f"{path}: header: expected {','.join(_COLUMNS)}, got no {listed(missing)}")
    poses: dict[str, tuple[Float64, dict[str, float]]] = {}
    for where, cells in rows:
        frame = cells["frame"]
        if not frame or frame in poses:
            raise InputError(f"{where}: frame: expected a name, each once, got {shown(frame)}")
        poses[frame] = _pose({name: number_in(where, name, cells) for name in _COLUMNS[1:]})
    if not poses:
        raise InputError(f"{path}: expected a row for each frame, got a header only")
    return poses


def _pose(row: dict[str, float]) -> tuple[Float64, dict[str, float]]:
    rotation = exp_rotation([row[name] for name in _ROTATION])
    first, second = row["jaw_2"], row["jaw_1"]
    joints = {
        "wrist_pitch": row["wrist_pitch"],
        "wrist_yaw": row["wrist_yaw"] + (second - first) / 2,
        "jaw": first + second,
    }
    return transform(rotation, [row[name] for name in _TRANSLATION]), joints
