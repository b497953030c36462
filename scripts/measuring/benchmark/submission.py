"""Submissions: CSV files with a row for each frame of each task, which the scorer reads.

Columns: ``task, world, frame, status``; the pose ``tx, ty, tz`` (m) and ``qx, qy, qz, qw`` of camera_from_root, of the
task base camera_from_base; the joints by name (rad); optional ``std_tx .. std_rz`` (m, rad) along and about the root's
own axes with ``std_JOINT`` (rad), or ``covariance``, the upper triangle of the matrix of the same numbers, by rows,
separated by blanks; optional ``seconds``, of processor time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import transform
from dvrk_cmaes.io.atomic import write_text
from dvrk_cmaes.io.csv_file import csv_text, number_in, read_csv_rows
from dvrk_cmaes.io.short_text import shown
from measuring.benchmark.tasks import BASE, TASKS, TaskName

Float64 = NDArray[np.float64]

STATUSES: Final = ("ok", "doubtful", "failed")
JOINTS: Final = ("wrist_pitch", "wrist_yaw", "jaw")
"""Joints of the bundled instrument."""
AXES: Final = ("tx", "ty", "tz", "rx", "ry", "rz")
_KEY: Final = ("task", "world", "frame", "status")
_POSE: Final = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
_STD: Final = tuple(f"std_{name}" for name in (*AXES, *JOINTS))
_REQUIRED: Final = (*_KEY, *_POSE, *JOINTS)
_OPTIONAL: Final = (*_STD, "covariance", "seconds")
_UNIT_NORM: Final = 1e-3  # by which a quaternion's length may differ from one

Key = tuple[TaskName, int, str]


@dataclass(frozen=True, eq=False)
class Row:
    """A frame of a submission: pose (4, 4), m, joints (J,), standard deviations (6 + J,) or covariance, or None."""

    task: TaskName
    world: int
    frame: str
    status: str
    pose: Float64 | None = None
    joints: Float64 | None = None
    std: Float64 | None = None
    covariance: Float64 | None = None
    seconds: float | None = None

    @property
    def key(self) -> Key:
        """Task, world and frame."""
        return self.task, self.world, self.frame


def write_submission(path: Path, rows: Iterable[Row]) -> None:
    """Write rows as a CSV file."""
    write_text(path, csv_text((*_REQUIRED, *_OPTIONAL), (_cells(row) for row in rows)))


def _cells(row: Row) -> list[object]:
    """Return the cells of a row in the order of the columns."""

    def padded(values: Float64 | None, count: int) -> list[str]:
        texts = [] if values is None else [f"{value:.9g}" for value in values]
        return texts + [""] * (count - len(texts))

    pose = None
    if row.pose is not None:
        pose = np.append(row.pose[:3, 3], Rotation.from_matrix(row.pose[:3, :3]).as_quat())
    triangle = None if row.covariance is None else row.covariance[np.triu_indices(len(row.covariance))]
    return [
        *(row.task, row.world, row.frame, row.status),
        *padded(pose, len(_POSE)),
        *padded(row.joints, len(JOINTS)),
        *padded(row.std if row.covariance is None else None, len(_STD)),
        " ".join(padded(triangle, 0)),
        "" if row.seconds is None else f"{row.seconds:.4g}",
    ]


def read_submission(path: Path) -> dict[Key, Row]:
    """Read a submission: rows by task, world and frame.

    Raises
    ------
    InputError
        Naming the file, the line and the column, what was expected and what was there.
    """
    header, lines = read_csv_rows(path, expected="a submission (CSV)")
    for name in _REQUIRED:
        if name not in header:
            raise InputError(f"{path}: header: expected a column {name}, got {shown(','.join(header))}")
    for name in header:
        if name not in (*_REQUIRED, *_OPTIONAL):
            raise InputError(f"{path}: header: expected one of {', '.join(_REQUIRED + _OPTIONAL)}, got {shown(name)}")
    rows: dict[Key, Row] = {}
    for where, cells in lines:
        row = _row(where, {name: cells.get(name, "") for name in _REQUIRED + _OPTIONAL})
        if row.key in rows:
            raise InputError(
                f"{where}: expected each frame once, got task {row.task}, world {row.world}, "
                f"frame {shown(row.frame)} again"
            )
        rows[row.key] = row
    return rows


def _row(where: str, cells: dict[str, str]) -> Row:
    """Read a row."""
    for name, known in (("task", tuple(TASKS)), ("status", STATUSES)):
        if cells[name] not in known:
            raise InputError(f"{where}: {name}: expected one of {', '.join(known)}, got {shown(cells[name])}")
    if not cells["world"].isdecimal():
        raise InputError(f"{where}: world: expected a number of the table, got {shown(cells['world'])}")
    of_base = cells["task"] == BASE
    if of_base and cells["frame"] != BASE:
        raise InputError(f"{where}: frame: expected {BASE} in the task {BASE}, got {shown(cells['frame'])}")
    count = 6 if of_base else len(_STD)
    row: dict[str, Any] = {"task": cells["task"], "world": int(cells["world"])}
    row |= {"frame": cells["frame"], "status": cells["status"]}
    row["seconds"] = number_in(where, "seconds", cells, "seconds") if cells["seconds"] else None
    pose = _numbers(where, cells, _POSE)
    if pose is None:
        if cells["status"] != "failed":
            raise InputError(f"{where}: tx: expected a pose with the status {cells['status']}, got a blank cell")
        return Row(**row)
    norm = float(np.linalg.norm(pose[3:]))
    if abs(norm - 1) > _UNIT_NORM:
        raise InputError(f"{where}: qx: expected a quaternion of length 1, got one of {norm:.4g}")
    row["pose"] = transform(Rotation.from_quat(pose[3:]).as_matrix(), pose[:3])
    row["joints"] = None if of_base else _numbers(where, cells, JOINTS)
    if row["joints"] is None and not of_base:
        raise InputError(f"{where}: {JOINTS[0]}: expected a finite number in radians, got a blank cell")
    row["std"] = _numbers(where, cells, _STD[:count])
    if row["std"] is not None and not (row["std"] > 0).all():
        raise InputError(f"{where}: {_STD[0]}: expected positive standard deviations, got {min(row['std']):g}")
    if cells["covariance"]:
        if row["std"] is not None:
            raise InputError(f"{where}: covariance: expected standard deviations or a covariance, got both")
        row["covariance"] = _covariance(where, cells["covariance"], count)
    return Row(**row)


def _numbers(where: str, cells: dict[str, str], names: Sequence[str]) -> Float64 | None:
    """Return the numbers of some cells; None if all are blank."""
    if not any(cells[name] for name in names):
        return None
    return np.array([number_in(where, name, cells) for name in names])


def _covariance(where: str, text: str, count: int) -> Float64:
    """Return a covariance (N, N) from the upper triangle."""
    wanted = count * (count + 1) // 2
    cells = {"covariance": ""}
    values = []
    for word in text.split():
        cells["covariance"] = word
        values.append(number_in(where, "covariance", cells))
    if len(values) != wanted:
        raise InputError(f"{where}: covariance: expected {wanted} numbers, got {len(values)}")
    matrix = np.zeros((count, count))
    matrix[np.triu_indices(count)] = values
    matrix = matrix + np.triu(matrix, 1).T
    least = (
        float(np.linalg.eigvalsh(matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix))))[0])
        if (np.diag(matrix) > 0).all()
        else -1.0
    )
    if least <= 0:
        raise InputError(f"{where}: covariance: expected a positive definite matrix, got one that is not")
    return np.asarray(matrix)
