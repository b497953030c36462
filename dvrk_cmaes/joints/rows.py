"""What every file of joint readings is read into: rows by frame, by number or by time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.joints.names import joint_reading


@dataclass(frozen=True, eq=False)
class JointRow:
    """One row or message: its cells by joint, as numbers or text, blank where unknown; its time in ns, if it has one.

    Cells are checked when they are asked for: a bad one does no harm to other frames. ``where`` begins the message.
    """

    where: str
    cells: Mapping[str, object]
    time: int | None = None

    def readings(self) -> dict[str, float]:
        """Check the cells and give those that are known, rad or m; InputError naming the one that is wrong."""
        known = {name: cell for name, cell in self.cells.items() if cell not in ("", None)}
        return {name: joint_reading(self.where, name, cell) for name, cell in known.items()}


@dataclass(frozen=True, eq=False)
class JointFile:
    """A file of readings.

    ``kind`` says in words what it is. ``rows`` are by label, and ``labels`` says what labels are: names of frames,
    whole numbers, or nothing but a count of messages. ``notes`` say what had to be decided by a rule.
    """

    path: str
    kind: str
    rows: Mapping[str, JointRow]
    labels: Literal["frame", "number", "message"]
    notes: tuple[str, ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that some row has a reading of, in the order they come in."""
        return tuple(dict.fromkeys(name for row in self.rows.values() for name, c in row.cells.items() if c != ""))

    @cached_property
    def timed(self) -> tuple[TimedReadings, ...]:
        """Readings over time, each joint by itself, of the rows that have a time; none where no row has one."""
        times: dict[str, list[int]] = {}
        values: dict[str, list[list[float]]] = {}
        for row in self.rows.values():
            if row.time is None:
                continue
            for name, value in row.readings().items():
                times.setdefault(name, []).append(row.time)
                values.setdefault(name, []).append([value])
        return tuple(TimedReadings.of(self.path, (name,), times[name], values[name]) for name in times)
