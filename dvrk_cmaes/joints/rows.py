"""Common representation of the files of joint readings: rows labelled by frame, by number or by message."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.joints.interpolation import TimedReadings
from dvrk_cmaes.joints.names import accepted_names, joint_reading

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
    known
        Names of the instrument's joints that are accepted besides the dVRK's.
    """

    arm: str | None = None
    columns: tuple[str, ...] = ()
    offset: int | None = None
    step: int = 1
    known: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints that are accepted."""
        return accepted_names(self.known)


BY_THEMSELVES = ReadAs()
"""Of files that say all of it."""


JointRow = tuple[str, Mapping[str, object], int | None]
"""One row or message of a file, as it is read: the prefix of error messages, numbers or texts by joint name, blank if a
reading is not known, and the time of the row, ns, or None."""

Labels = Literal["frame", "number", "message"]
"""What names the rows of a file: names of frames, whole numbers, or nothing, as of messages."""

NO_TIME: Final = int(np.iinfo(np.int64).min)
"""In place of the time of a row that has none."""


class RowNames(Mapping[str, int]):
    """The places of rows by their names (N,), ASCII; as an array, names take a tenth of the memory of a dictionary."""

    def __init__(self, names: NDArray[np.bytes_]) -> None:
        self._names, self._order = names, names.argsort(kind="stable")

    @property
    def differ(self) -> bool:
        """Whether each name is there once."""
        in_order = self._names[self._order]
        return not (in_order[1:] == in_order[:-1]).any()

    def __getitem__(self, name: str) -> int:
        key = np.array(name.encode("ascii", "replace"), self._names.dtype)
        place = min(int(np.searchsorted(self._names, key, sorter=self._order)), len(self) - 1)
        found = int(self._order[place])
        if self._names[found].decode() != name:
            raise KeyError(name)
        return found

    def __iter__(self) -> Iterator[str]:
        return (name.decode() for name in self._names)

    def __len__(self) -> int:
        return len(self._names)


@dataclass(frozen=True, eq=False)
class JointFile:
    """A file of N rows of readings of J joints.

    Parameters
    ----------
    path
        Path of the file, for messages.
    kind
        Description of the format.
    labels
        What names the rows.
    names
        Place of each row by its label, in the file's order; empty for messages.
    joints
        Names of the joints that rows state, some of which may have no reading.
    times : (N,) int64
        Times of the rows, ns; ``NO_TIME`` for those without.
    values : (N, J)
        Readings, rad or m; NaN where there is none.
    wrong
        What is wrong in a row, by its place; this does not affect other rows.
    notes
        Assumptions made where the file is ambiguous, one sentence each.
    """

    path: str
    kind: str
    labels: Labels
    names: Mapping[str, int]
    joints: tuple[str, ...]
    times: NDArray[np.int64]
    values: Float64
    wrong: Mapping[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, path: str, kind: str, rows: Mapping[str, JointRow], labels: Labels, notes: tuple[str, ...] = ()
    ) -> JointFile:
        """Create a file from its rows by label."""
        joints = tuple(dict.fromkeys(name for _, cells, _ in rows.values() for name in cells))
        values, wrong = np.full((len(rows), len(joints)), np.nan), dict[int, str]()
        for place, (where, cells, _) in enumerate(rows.values()):
            known = [(k, name) for k, name in enumerate(joints) if not is_missing(cells.get(name))]
            try:
                values[place, [k for k, _ in known]] = [joint_reading(where, name, cells[name]) for _, name in known]
            except InputError as error:
                wrong[place] = str(error)
        times = np.array([NO_TIME if time is None else time for _, _, time in rows.values()], np.int64)
        names = {} if labels == "message" else {label: place for place, label in enumerate(rows)}
        return cls(path, kind, labels, names, joints, times, values, wrong, notes)

    def readings(self, place: int) -> dict[str, float]:
        """Return the known readings of a row, rad or m, by joint; InputError names a wrong cell."""
        if place in self.wrong:
            raise InputError(self.wrong[place])
        return {n: value for n, value in zip(self.joints, self.values[place].tolist(), strict=True) if value == value}

    def time(self, name: str) -> int | None:
        """Return the time of the row with a label, ns; None without a row or its time."""
        found = int(self.times[self.names[name]]) if name in self.names else NO_TIME
        return None if found == NO_TIME else found

    def by_number(self, frames: Iterable[str], offset: int, step: int) -> JointFile:
        """Return the file with the names of frames for the rows that have their numbers, as in `ReadAs`.

        Raises
        ------
        InputError
            No frame has a row.
        """
        rows = {number: label for label in self.names if (number := number_of(label)) is not None}
        named = {
            label: frame
            for frame in frames
            if (number := number_of(frame)) is not None and (label := rows.get(offset + step * number)) is not None
        }
        if not named:
            raise InputError(
                f"{self.path}: --frame-offset {offset}, --frame-step {step}: expected rows of the frames, got none of "
                f"{listed(frames)} among {listed(self.names)}"
            )
        renamed = {named.get(label, f"{label} (no frame)"): place for label, place in self.names.items()}
        note = f"frame N has row {offset} + {step} N of {Path(self.path).name}"
        return replace(self, names=renamed, labels="frame", notes=(*self.notes, note))

    @cached_property
    def timed(self) -> tuple[TimedReadings, ...]:
        """Time series of the rows that have a time, one of the joints that are read in the same of them.

        InputError names a wrong cell of these rows.
        """
        timed, groups = self.times != NO_TIME, dict[bytes, tuple[Bool, list[int]]]()
        for place in (place for place in self.wrong if timed[place]):
            raise InputError(self.wrong[place])
        for column, cells in enumerate(self.values.T):
            rows = timed & ~np.isnan(cells)
            if rows.any():
                groups.setdefault(rows.tobytes(), (rows, []))[1].append(column)
        found = []
        for rows, columns in groups.values():
            every = slice(None) if rows.all() else rows  # a view takes no memory
            values = self.values if len(columns) == len(self.joints) else self.values[:, columns]
            names = tuple(self.joints[column] for column in columns)
            found.append(TimedReadings.of(self.path, names, self.times[every], values[every]))
        return tuple(found)


def is_missing(cell: object) -> bool:
    """Whether a cell has no reading: it is blank, NaN, or what tools write there."""
    return cell is None or cell != cell or (isinstance(cell, str) and cell.lower() in _MISSING)


def number_of(name: str) -> int | None:
    """Return the number that a name ends in; None if it does not."""
    match = _NUMBER.search(name)
    return None if match is None else int(match[0])
