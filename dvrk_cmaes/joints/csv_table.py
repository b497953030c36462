"""Reader of joint readings as CSV.

Three formats are read:

- joints.csv of a session: columns ``frame`` (text: "0026" is not "26"), ``time`` in seconds, or both, and any joints.
- a topic written by jhu-dvrk's data_collection: comment lines ``# Topic:`` and ``# Type:``, then the columns
  ``timestamp`` (ns) and a message's fields, ``name.0 ...`` and ``position.0 ...``.
- a table with the columns ``measured_q1`` to ``measured_q6``, without the jaw. Its columns ``measured_x, y, z`` are a
  point of the arm, not the tip, and are not used.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.csv_file import Rows, read_csv_rows
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.names import ARM_ORDER, check_joint, joints_by_count, without_ros_prefix
from dvrk_cmaes.joints.rows import JointFile, JointRow
from dvrk_cmaes.joints.times import parse_time

EXPECTED = "joint readings (joints.csv, or name=value,name=value)"

_MEASURED = tuple(f"measured_q{k}" for k in range(1, 7))
_COMMENT = re.compile(r"#\s*(\w+):\s*(\S*)")


def read_joint_csv(path: str, text: str, names: Sequence[str]) -> JointFile:
    """Read a CSV of any of these formats, recognised by its header.

    Parameters
    ----------
    path
        The file's path, for messages.
    text
        The file's content.
    names
        Names of the joints that are accepted.

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
    header, rows = read_csv_rows(path, expected=EXPECTED, text=body)
    if set(_MEASURED) <= set(header):
        return _measured_table(path, header, rows)
    if "timestamp" in header:
        return _topic_table(path, header, rows, comments, names)
    return _session_table(path, header, rows, names)


def _session_table(path: str, header: list[str], rows: Rows, names: Sequence[str]) -> JointFile:
    """Read the rows of a joints.csv."""
    if "frame" not in header and "time" not in header:
        raise InputError(f"{path}: header: expected a column frame and columns of joints, got {listed(header)}")
    for name in header:
        if name not in ("frame", "time"):
            check_joint(f"{path}: header", name, names)
    found: dict[str, JointRow] = {}
    for count, (where, cells) in enumerate(rows):
        label = cells.pop("frame", f"row {count + 1}")
        time_cell = cells.pop("time", "")
        if not label:
            raise InputError(f"{where}: frame: expected a name, got a blank cell")
        if label in found:
            raise InputError(f"{where}: frame: expected each frame once, got {shown(label)} again")
        time = parse_time(where, time_cell) if time_cell else None
        found[label] = JointRow(f"{path}: frame {label}" if "frame" in header else where, cells, time)
    if not found:
        raise InputError(f"{path}: expected a row for each frame, got a header only")
    return JointFile(path, "joints.csv", found, "frame" if "frame" in header else "message")


def _measured_table(path: str, header: list[str], rows: Rows) -> JointFile:
    """Read the rows of a table with measured_q1 to measured_q6, labelled by ``traj_index``, or else by row number."""
    time_columns = [name for name in ("time", "timestamp") if name in header]
    found: dict[str, JointRow] = {}
    for count, (where, cells) in enumerate(rows):
        label = _whole_number(where, "traj_index", cells["traj_index"]) if "traj_index" in cells else str(count)
        if label in found:
            raise InputError(f"{where}: traj_index: expected each number once, got {label} again")
        values = {joint: cells[name] for joint, name in zip(ARM_ORDER, _MEASURED, strict=True)}
        time = parse_time(where, cells[time_columns[0]]) if time_columns and cells[time_columns[0]] else None
        found[label] = JointRow(where, values, time)
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


def _topic_table(path: str, header: list[str], rows: Rows, comments: dict[str, str], names: Sequence[str]) -> JointFile:
    """Read the messages of a topic as data_collection writes them."""
    kind = comments.get("type", "")
    if kind and not kind.endswith("/JointState"):
        raise InputError(f"{path}: # Type: expected sensor_msgs/JointState, got {shown(kind)}")
    columns = [name for name in header if re.fullmatch(r"position\.\d+", name)]
    if not columns:
        raise InputError(f"{path}: header: expected columns position.0, ..., got {listed(header)}")
    found: dict[str, JointRow] = {}
    for count, (where, cells) in enumerate(rows):
        filled = [name for name in columns if cells[name]]
        stated = [cells.get(name.replace("position", "name"), "") for name in filled]
        if any(stated):
            joints = tuple(without_ros_prefix(name, names) for name in stated)
            for joint in joints:
                check_joint(where, joint, names)
        else:
            joints = joints_by_count(f"{where}: position", len(filled))
        values = dict(zip(joints, (cells[name] for name in filled), strict=True))
        found[f"message {count + 1}"] = JointRow(where, values, _timestamp(where, cells["timestamp"]))
    if not found:
        raise InputError(f"{path}: expected a row for each message, got a header only")
    named = any(name.startswith("name.") for name in header)
    notes = () if named else ("joints are not named: taken in the dVRK's order, by their number",)
    topic = comments.get("topic")
    return JointFile(
        path, f"JointState topic {topic or ''}".rstrip() + " (data_collection CSV)", found, "message", notes
    )
