"""Joint readings of frames, from files of any kind that labs have, or written out as ``name=value,name=value``.

A column that is not there or a blank cell is a reading that is not known, which is not the same as zero. Files whose
rows have times give a frame its readings at the image's time, interpolated between the rows on either side of it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.csv_table import EXPECTED, read_joint_csv
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.joint_state import is_joint_state, read_joint_state
from dvrk_cmaes.joints.names import OUTER_JOINTS, WRIST_JOINTS, all_names, check_joint, joint_reading
from dvrk_cmaes.joints.npy import MAGIC, read_joint_npy
from dvrk_cmaes.joints.rows import JointFile, JointRow
from dvrk_cmaes.joints.times import time_in_name

__all__ = [
    "OUTER_JOINTS",
    "TIME_TOLERANCE",
    "WRIST_JOINTS",
    "FrameReadings",
    "JointFile",
    "frame_readings",
    "is_written_out",
    "read_frame_joints",
    "read_joint_file",
    "read_joint_table",
    "read_joints",
]

TIME_TOLERANCE = NANOSECONDS // 20
"""Readings before and after an image may be this far from it in time, ns."""

_LARGEST = 1_000_000_000  # bytes; an hour at 1 kHz has half of it
_LARGEST_YAML = 20_000_000  # bytes; some 50,000 messages, which take half a minute


@dataclass(frozen=True)
class FrameReadings:
    """Readings of one frame by joint, rad or m; ``notes`` on what had to be decided by a rule.

    ``farthest`` is the distance in time, ns, of the farthest reading that was interpolated from; None where none was.
    """

    readings: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    farthest: int | None = None


def read_joints(text_or_path: str | Path, *, frame: str | None = None, known: Iterable[str] = ()) -> dict[str, float]:
    """Read the joint readings of one frame.

    Parameters
    ----------
    text_or_path
        ``wrist_pitch=-0.68,wrist_yaw=-0.36,jaw=1.34``, or the path of a file of readings. Text with an equals sign is
        a path only if such a file exists.
    frame
        Which row of a joints.csv; may be left out if it has one row only. Not used for written-out readings.
    known
        Names of the instrument's own joints, besides ``OUTER_JOINTS`` and ``WRIST_JOINTS``.

    Returns
    -------
    dict
        Joint name to reading, rad, or m for ``insertion``; only the joints that were read.

    Raises
    ------
    InputError
        Naming the file and the frame or the joint, and what was expected.
    """
    file = read_joint_file(text_or_path, known=known)
    return _chosen(file, frame).readings()


def read_joint_table(path: str | Path, *, known: Iterable[str] = ()) -> dict[str, dict[str, float]]:
    """Read the joint readings of all rows of a file, by frame (or number, or message) in the order of its rows.

    ``known`` and the errors are those of ``read_joints``.
    """
    return {label: row.readings() for label, row in read_joint_file(path, known=known).rows.items()}


def read_joint_file(text_or_path: str | Path, *, known: Iterable[str] = ()) -> JointFile:
    """Read a file of readings of any kind, told by its content, or written-out readings as a file of one row.

    ``known`` and the errors are those of ``read_joints``.
    """
    names = all_names(known)
    if is_written_out(text_or_path):
        row = JointRow("joints", _written_out(str(text_or_path), names))
        return JointFile("joints", "written-out readings", {"": row}, "message")
    path = str(text_or_path)
    data = read_bytes(path, expected=EXPECTED, largest=_LARGEST)
    if data.startswith(MAGIC):
        return read_joint_npy(path, data)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected {EXPECTED} in UTF-8, got other bytes at {error.start}") from None
    if not is_joint_state(text):
        return read_joint_csv(path, text, names)
    if len(data) > _LARGEST_YAML:
        raise InputError(
            f"{path}: expected at most {_LARGEST_YAML / 1e6:g} MB of messages as YAML, got {len(data) / 1e6:.1f} MB: "
            "import a bag instead"
        )
    return read_joint_state(path, text, names)


def frame_readings(
    files: Sequence[JointFile],
    frame: str,
    *,
    time: int | None = None,
    tolerance: int = TIME_TOLERANCE,
    single: bool = False,
) -> FrameReadings:
    """Find the readings of one frame in all files that a session has.

    A file whose rows have times is interpolated to the image's time, if that is known and is not the very time of the
    frame's own row. Otherwise a row is the frame's by its name; rows that are only numbered, by the whole number that
    the frame's name ends in.

    Parameters
    ----------
    files
        From ``read_joint_file``; each joint in one of them only.
    frame
        The frame's name.
    time
        The image's time, ns.
    tolerance
        How far the readings before and after the image may be from it, ns.
    single
        Whether there is one frame only, so that a file's only row is its.

    Raises
    ------
    InputError
        No readings near enough in time, a time that is needed but not known, a joint in two files, a bad cell.
    """
    readings: dict[str, float] = {}
    origin: dict[str, str] = {}
    notes: list[str] = []
    farthest: int | None = None
    for file in files:
        named = file.rows.get(frame) if file.labels == "frame" else None
        if time is not None and file.timed and (named is None or named.time != time):
            found, distance = _interpolated(file, frame, time, tolerance)
            farthest = max(distance, farthest or 0)
        else:
            row, note = _row_of(file, frame, single=single)
            found = {} if row is None else row.readings()
            notes.extend(note)
        for name, value in found.items():
            if name in readings:
                raise InputError(f"{file.path}: {name}: expected each joint in one file, got it in {origin[name]} too")
            readings[name], origin[name] = value, file.path
    return FrameReadings(readings, tuple(notes), farthest)


def read_frame_joints(
    sources: Sequence[str | Path],
    *,
    frame: str | None,
    image: str,
    time: int | None = None,
    known: Iterable[str] = (),
) -> FrameReadings:
    """Read the readings of a frame that stands by itself from all its sources.

    Parameters
    ----------
    sources
        As ``read_joints``; each joint in one of them only.
    frame
        The frame's name, where it was given; its row must then be there.
    image
        The image's name, which is the frame's if none was given; a table's only row will then do for any.
    time
        The image's time, ns; the one that its name ends in unless given.
    known
        As in ``read_joints``.

    Raises
    ------
    InputError
        As ``frame_readings``; a frame without a row.
    """
    files = [read_joint_file(source, known=known) for source in sources]
    name = image if frame is None else frame
    moment = time_in_name(image) if time is None else time
    for file in files:
        only = len(file.rows) == 1 and (frame is None or file.labels == "number")
        if file.labels != "message" and not only and not (moment is not None and file.timed):
            _chosen(file, name)  # refuses a name that is not there
    return frame_readings(files, name, time=moment, single=True)


def is_written_out(text_or_path: str | Path) -> bool:
    """Whether readings are written out as ``name=value,...`` rather than named by a path."""
    return isinstance(text_or_path, str) and "=" in text_or_path and not os.path.exists(text_or_path)


def _written_out(text: str, names: tuple[str, ...]) -> dict[str, float]:
    """Parse readings written as ``name=value,name=value``."""
    readings: dict[str, float] = {}
    for item in text.split(","):
        name, equals, value = (part.strip() for part in item.partition("="))
        if not equals:
            raise InputError(f"joints: expected name=value,name=value, got {shown(item.strip())}")
        check_joint("joints", name, names)
        if name in readings:
            raise InputError(f"joints: {name}: expected one reading, got two")
        readings[name] = joint_reading("joints", name, value)
    return readings


def _interpolated(file: JointFile, frame: str, time: int, tolerance: int) -> tuple[dict[str, float], int]:
    """Interpolate to a time; also the distance of the farthest reading used, ns."""
    found: dict[str, float] = {}
    farthest = 0
    for timed in file.timed:
        at = timed.at(time, tolerance)
        if at is None:
            away = timed.distance(time) / NANOSECONDS
            raise InputError(
                f"{file.path}: frame {frame}: {timed.joints[0]}: expected readings before and after the image's time "
                f"{time / NANOSECONDS:.3f} s, within {tolerance / NANOSECONDS:g} s, got the nearest {away:.3f} s away"
            )
        found[timed.joints[0]] = float(at[0][0])
        farthest = max(farthest, at[1])
    return found, farthest


def _row_of(file: JointFile, frame: str, *, single: bool) -> tuple[JointRow | None, tuple[str, ...]]:
    """Row of a frame, None where a joints.csv has none, and how it was told."""
    if single and len(file.rows) == 1:
        return next(iter(file.rows.values())), ()
    if file.labels == "frame":
        return file.rows.get(frame), ()
    if file.labels == "number":
        digits = re.search(r"\d+$", frame)
        label = "" if digits is None else str(int(digits[0]))
        if label in file.rows:
            return file.rows[label], (
                f"frame {frame} is taken for row {label} of {Path(file.path).name}, by its number",
            )
        return None, ()
    raise InputError(
        f"{file.path}: frame {frame}: expected the image's time (images.csv, or --time), to find its readings among "
        f"{len(file.rows)} without a frame's name"
    )


def _chosen(file: JointFile, frame: str | None) -> JointRow:
    """Row that is meant by name, or the only one."""
    if file.labels == "message" and len(file.rows) == 1:
        return next(iter(file.rows.values()))
    labels = list(file.rows)
    if frame is None:
        if len(labels) == 1:
            return file.rows[labels[0]]
        raise InputError(
            f"{file.path}: frame: expected the name of one of its {len(labels)} frames ({listed(labels)}), got none"
        )
    row, _ = _row_of(file, frame, single=False)
    if row is None:
        near = listed(nearest_first(frame, labels))
        raise InputError(f"{file.path}: frame: expected one of its {len(labels)} frames ({near}), got {shown(frame)}")
    return row
