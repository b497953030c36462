"""Submissions: files of JSON Lines with a row for each frame of each task, which the scorer reads.

A row has ``task``, ``world`` and the fields of a result: ``frame``, ``status``, ``camera_from_root`` (of the task base
the pose camera_from_base), ``joints``, optional ``covariance`` or ``std``, and ``seconds``, of processor time.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.atomic import write_text
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.results.result import Result
from measuring.benchmark.tasks import BASE, TASKS, TaskName

JOINTS: Final = ("wrist_pitch", "wrist_yaw", "jaw")
"""Joints of the bundled instrument."""
STATED: Final = ("status", "camera_from_root", "joints", "covariance", "std", "seconds")
"""Fields of a row besides its key."""

Key = tuple[TaskName, int, str]


@dataclass(frozen=True, eq=False)
class Row:
    """A frame of a submission, and what is stated of it: the fields of a result."""

    task: TaskName
    world: int
    frame: str
    stated: Mapping[str, Any]

    @property
    def key(self) -> Key:
        """Task, world and frame."""
        return self.task, self.world, self.frame


def write_submission(path: Path, rows: Iterable[Row]) -> None:
    """Write rows as JSON Lines."""
    lines = ({"task": row.task, "world": row.world, "frame": row.frame, **row.stated} for row in rows)
    write_text(path, "".join(f"{json.dumps(line)}\n" for line in lines))


def read_submission(path: Path) -> dict[Key, Row]:
    """Read a submission: rows by task, world and frame.

    Raises
    ------
    InputError
        Naming the file, the line and the field, what was expected and what was there.
    """
    rows: dict[Key, Row] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        where = f"{path}: line {number}"
        try:
            fields = json.loads(line)
        except ValueError:
            raise InputError(f"{where}: expected a row as JSON, got {shown(line)}") from None
        Result.from_dict({"joints": {}, **fields, "std": None}, where=where)
        if fields.get("task") not in TASKS or not isinstance(fields.get("world"), int):
            got = shown([fields.get("task"), fields.get("world")])
            raise InputError(f"{where}: task, world: expected one of {', '.join(TASKS)}, and a number, got {got}")
        joints = JOINTS if fields["task"] != BASE and fields.get("camera_from_root") is not None else ()
        if missing := [name for name in joints if name not in fields.get("joints", {})]:
            raise InputError(f"{where}: joints: expected {', '.join(JOINTS)} in rad, got no {missing[0]}")
        stated = {name: fields[name] for name in STATED if name in fields}
        row = Row(fields["task"], fields["world"], str(fields.get("frame")), stated)
        if row.key in rows:
            raise InputError(f"{where}: expected each frame once, got {shown([*row.key])} again")
        rows[row.key] = row
    return rows
