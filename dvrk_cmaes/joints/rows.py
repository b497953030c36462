"""Common representation of the files of joint readings: rows labelled by frame, by number or by message."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.joints.names import joint_reading


@dataclass(frozen=True, eq=False)
class JointRow:
    """One row or message of a file of readings.

    The cells are checked only when the readings are requested, so that a wrong cell does not affect other rows.

    Parameters
    ----------
    where
        Prefix of error messages.
    cells
        Numbers or texts by joint name, blank if the reading is not known.
    time
        Time of the row, ns, or None.
    """

    where: str
    cells: Mapping[str, object]
    time: int | None = None

    def readings(self) -> dict[str, float]:
        """Check the cells and return the known readings, rad or m; InputError names a wrong cell."""
        known = {name: cell for name, cell in self.cells.items() if cell not in ("", None)}
        return {name: joint_reading(self.where, name, cell) for name, cell in known.items()}


@dataclass(frozen=True, eq=False)
class JointFile:
    """A file of readings.

    Parameters
    ----------
    path
        Path of the file, for messages.
    kind
        Description of the format.
    rows
        The rows by label.
    labels
        Kind of the labels: names of frames, whole numbers, or running numbers of messages.
    notes
        Assumptions made where the file is ambiguous, one sentence each.
    """

    path: str
    kind: str
    rows: Mapping[str, JointRow]
    labels: Literal["frame", "number", "message"]
    notes: tuple[str, ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints with a reading in at least one row, in order of appearance."""
        return tuple(dict.fromkeys(name for row in self.rows.values() for name, c in row.cells.items() if c != ""))

    @cached_property
    def timed(self) -> tuple[TimedReadings, ...]:
        """Time series of each joint, from the rows that have a time."""
        times: dict[str, list[int]] = {}
        values: dict[str, list[list[float]]] = {}
        for row in self.rows.values():
            if row.time is None:
                continue
            for name, value in row.readings().items():
                times.setdefault(name, []).append(row.time)
                values.setdefault(name, []).append([value])
        return tuple(TimedReadings.of(self.path, (name,), times[name], values[name]) for name in times)
