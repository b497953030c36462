"""Common representation of the files of joint readings: rows labelled by frame, by number or by message."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.joints.names import joint_reading

_NUMBER = re.compile(r"\d+$")
_MISSING = ("", "nan", "na", "n/a", "<na>", "none", "null", "-")  # cells of tools that write out a missing reading


@dataclass(frozen=True)
class ReadAs:
    """How files of readings are read where they do not say it themselves.

    Parameters
    ----------
    arm
        The arm whose joints are read of a file with those of several; None for the only one.
    columns
        Names of the columns of a CSV, in place of its header.
    offset, step
        A frame of number n has the row of number ``offset`` + ``step`` n; without an ``offset``, rows are found by
        name.
    """

    arm: str | None = None
    columns: tuple[str, ...] = ()
    offset: int | None = None
    step: int = 1


BY_THEMSELVES = ReadAs()
"""Of files that say all of it."""


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
        known = {name: cell for name, cell in self.cells.items() if not is_missing(cell)}
        return {name: joint_reading(self.where, name, cell) for name, cell in known.items()}


@dataclass(frozen=True, eq=False)
class TableRows(Mapping[str, JointRow]):
    """Rows of a table of numbers, each of which is made when it is asked for.

    ``times`` (N,), ns, strictly increasing; ``table`` (N, J), rad or m, NaN where there is no reading.
    """

    path: str
    joints: tuple[str, ...]
    times: NDArray[np.int64]
    table: Float64

    def __getitem__(self, label: str) -> JointRow:
        number = label.removeprefix("row ")
        if number == label or not number.isdecimal() or not 1 <= int(number) <= len(self.times):
            raise KeyError(label)
        k = int(number) - 1
        cells = dict(zip(self.joints, self.table[k].tolist(), strict=True))
        return JointRow(f"{self.path}: line {k + 2}", cells, int(self.times[k]))

    def __iter__(self) -> Iterator[str]:
        return (f"row {k + 1}" for k in range(len(self.times)))

    def __len__(self) -> int:
        return len(self.times)

    def series(self) -> dict[str, TimedReadings]:
        """Return the readings of each joint that has some; InputError names a wrong cell."""
        found = {}
        for place, name in enumerate(self.joints):
            column = self.table[:, place]
            known = ~np.isnan(column)
            for worst in (np.nanargmax(column), np.nanargmin(column)) if known.any() else ():
                self[f"row {worst + 1}"].readings()  # raises InputError for one in another unit
            if known.all():
                found[name] = TimedReadings((name,), self.times, column[:, None], self.path)
            elif known.any():
                found[name] = TimedReadings((name,), self.times[known], column[known][:, None], self.path)
        return found


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

    def by_number(self, frames: Iterable[str], offset: int, step: int) -> JointFile:
        """Return the file with the names of frames for the rows that have their numbers, as in `ReadAs`.

        Raises
        ------
        InputError
            No frame has a row.
        """
        rows = {number: label for label in self.rows if (number := number_of(label)) is not None}
        named = {
            label: frame
            for frame in frames
            if (number := number_of(frame)) is not None and (label := rows.get(offset + step * number)) is not None
        }
        if not named:
            raise InputError(
                f"{self.path}: --frame-offset {offset}, --frame-step {step}: expected rows of the frames, got none of "
                f"{listed(frames)} among {listed(self.rows)}"
            )
        renamed = {named.get(label, f"{label} (no frame)"): row for label, row in self.rows.items()}
        note = f"frame N has row {offset} + {step} N of {Path(self.path).name}"
        return replace(self, rows=renamed, labels="frame", notes=(*self.notes, note))

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints with a reading in at least one row, in order of appearance."""
        if isinstance(self.rows, TableRows):
            return tuple(self.rows.series())
        return tuple(
            dict.fromkeys(name for row in self.rows.values() for name, c in row.cells.items() if not is_missing(c))
        )

    @cached_property
    def timed(self) -> tuple[TimedReadings, ...]:
        """Time series of each joint, from the rows that have a time."""
        if isinstance(self.rows, TableRows):
            return tuple(self.rows.series().values())
        times: dict[str, list[int]] = {}
        values: dict[str, list[list[float]]] = {}
        for row in self.rows.values():
            if row.time is None:
                continue
            for name, value in row.readings().items():
                times.setdefault(name, []).append(row.time)
                values.setdefault(name, []).append([value])
        return tuple(TimedReadings.of(self.path, (name,), times[name], values[name]) for name in times)


def is_missing(cell: object) -> bool:
    """Whether a cell has no reading: it is blank, NaN, or what tools write there."""
    return cell is None or cell != cell or (isinstance(cell, str) and cell.lower() in _MISSING)


def number_of(name: str) -> int | None:
    """Return the number that a name ends in; None if it does not."""
    match = _NUMBER.search(name)
    return None if match is None else int(match[0])
