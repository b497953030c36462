"""Reader of joint readings as CSV.

These formats are read:

- joints.csv of a session: columns ``frame`` (text: "0026" is not "26"), ``time`` in seconds, or both, and any joints.
- a topic written by jhu-dvrk's data_collection: comment lines ``# Topic:`` and ``# Type:``, then the columns
  ``timestamp`` (ns) and a message's fields, ``name.0 ...`` and ``position.0 ...``.
- a table with a column of times (``time``, ``timestamp``, ``time_ms``) or no labels at all, and columns of joints,
  which may have ROS prefixes. Without a header, the columns are named by the user.
- tables of other tools, see `other_tables`.
- a table with the columns ``measured_q1`` to ``measured_q6``, without the jaw. Its columns ``measured_x, y, z`` are a
  point of the arm, not the tip, and are not used.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.csv_file import Rows, read_csv_rows
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.names import ARM_ORDER, IN_ORDER, joints_by_count, joints_of_arm, without_positions
from dvrk_cmaes.joints.other_tables import usual
from dvrk_cmaes.joints.rows import JointFile, JointRow
from dvrk_cmaes.joints.times import parse_time, parse_times, time_column

EXPECTED = "joint readings (joints.csv, or name=value,name=value)"

_MEASURED = tuple(f"measured_q{k}" for k in range(1, 7))
_POSITION = re.compile(r"position\.\d+")
_COMMENT = re.compile(r"#\s*(\w+):\s*(\S*)")


def read_joint_csv(
    path: str, text: str, names: Sequence[str], arm: str | None = None, columns: Sequence[str] = ()
) -> JointFile:
    """Read a CSV of any of these formats, recognised by its header.

    Parameters
    ----------
    path
        The file's path, for messages.
    text
        The file's content.
    names
        Names of the joints that are accepted.
    arm
        The arm whose joints are read of a table with those of several.
    columns
        Names of the columns, in place of the header's; ``-`` for one that is not read.

    Raises
    ------
    InputError
        The table is not valid; the message names the file, the line and what was expected.
    """
    comments: dict[str, str] = {}
    body = text
    while body.startswith("#"):
        line, _, body = body.partition("\n")
        match = _COMMENT.match(line)
        if match is not None:
            comments[match[1].lower()] = match[2]
    header, rows = usual(*read_csv_rows(path, expected=EXPECTED, text=body, columns=columns))
    if set(_MEASURED) <= set(header):
        return _measured_table(path, header, rows)
    if "timestamp" in header and ("type" in comments or any(_POSITION.fullmatch(name) for name in header)):
        return _topic_table(path, header, rows, comments, names, arm)
    return _joint_table(path, header, rows, names, arm, numbered=bool(columns))


def _joint_table(
    path: str, header: list[str], rows: Rows, names: Sequence[str], arm: str | None, *, numbered: bool
) -> JointFile:
    """Read a joints.csv, or another table of joints: with frames, times, or, if ``numbered``, neither."""
    time = time_column(path, header)
    if "frame" not in header and time is None and not numbered:
        raise InputError(
            f"{path}: header: expected a column frame or time and columns of joints, got {listed(header)} (rows that "
            "are only counted are read with --columns and the names of the columns)"
        )
    joints = [name for name in header if name not in ("frame", time, "-")]
    places = joints_of_arm(f"{path}: header", joints, names, arm)
    times = parse_times(time, [(where, cells[time]) for where, cells in rows]) if time else [None] * len(rows)
    found: dict[str, JointRow] = {}
    for count, ((where, cells), moment) in enumerate(zip(rows, times, strict=True)):
        label = cells["frame"] if "frame" in header else f"row {count + 1}" if time else str(count)
        if not label:
            raise InputError(f"{where}: frame: expected a name, got a blank cell")
        if label in found:
            raise InputError(f"{where}: frame: expected each frame once, got {shown(label)} again")
        values = {joint: cells[joints[place]] for joint, place in places.items()}
        found[label] = JointRow(f"{path}: frame {label}" if "frame" in header else where, values, moment)
    if not found:
        raise InputError(f"{path}: expected a row for each frame, got a header only")
    return JointFile(path, "joints.csv", found, "frame" if "frame" in header else "message" if time else "number")


def _measured_table(path: str, header: list[str], rows: Rows) -> JointFile:
    """Read the rows of a table with measured_q1 to measured_q6, labelled by ``traj_index``, or else by row number."""
    time = time_column(path, header)
    times = parse_times(time, [(where, cells[time]) for where, cells in rows]) if time else [None] * len(rows)
    found: dict[str, JointRow] = {}
    for count, ((where, cells), moment) in enumerate(zip(rows, times, strict=True)):
        label = _whole_number(where, "traj_index", cells["traj_index"]) if "traj_index" in cells else str(count)
        if label in found:
            raise InputError(f"{where}: traj_index: expected each number once, got {label} again")
        values = {joint: cells[name] for joint, name in zip(ARM_ORDER, _MEASURED, strict=True)}
        found[label] = JointRow(where, values, moment)
    if not found:
        raise InputError(f"{path}: expected a row for each frame, got a header only")
    notes = (f"measured_q1 to measured_q6 are taken as {', '.join(ARM_ORDER)}; the jaw is not among them",)
    return JointFile(path, "measured_q1 to measured_q6 (CSV)", found, "number", notes)


def _whole_number(where: str, name: str, cell: str) -> str:
    """Return the decimal text of a whole number, which may be written as 26.0; InputError for other cells."""
    try:
        number = float(cell)
        if number == int(number):
            return str(int(number))
    except (ValueError, OverflowError):
        pass
    raise InputError(f"{where}: {name}: expected a whole number, got {shown(cell)}")


def _timestamp(where: str, cell: str) -> int:
    """Parse the time of a message, ns; data_collection writes whole nanoseconds, also for small numbers."""
    return int(cell) if cell.isdecimal() and len(cell) < 19 else parse_time(where, cell)


def _topic_table(
    path: str, header: list[str], rows: Rows, comments: dict[str, str], names: Sequence[str], arm: str | None
) -> JointFile:
    """Read the messages of a topic as data_collection writes them; those without positions are skipped."""
    kind = comments.get("type", "")
    if kind and not kind.endswith("/JointState"):
        raise InputError(f"{path}: # Type: expected sensor_msgs/JointState, got {shown(kind)}")
    columns = [name for name in header if _POSITION.fullmatch(name)]
    if not columns:
        raise InputError(f"{path}: header: expected columns position.0, ..., got {listed(header)}")
    found: dict[str, JointRow] = {}
    for count, (where, cells) in enumerate(rows):
        filled = [name for name in columns if cells[name]]
        if not filled:
            continue
        stated = [cells.get(name.replace("position", "name"), "") for name in filled]
        if any(stated):
            places = joints_of_arm(where, stated, names, arm)
        else:
            places = {joint: place for place, joint in enumerate(joints_by_count(f"{where}: position", len(filled)))}
        values = {joint: cells[filled[place]] for joint, place in places.items()}
        found[f"message {count + 1}"] = JointRow(where, values, _timestamp(where, cells["timestamp"]))
    if not found:
        raise InputError(
            f"{path}: expected a row for each message, got {'none with positions' if rows else 'a header only'}"
        )
    notes = [] if any(name.startswith("name.") for name in header) else [IN_ORDER]
    if len(found) < len(rows):
        notes.append(without_positions(len(rows) - len(found)))
    topic = comments.get("topic")
    described = f"JointState topic {topic or ''}".rstrip() + " (data_collection CSV)"
    return JointFile(path, described, found, "message", tuple(notes))
