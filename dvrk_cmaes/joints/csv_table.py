"""Joint readings as CSV: a session's joints.csv, a topic that jhu-dvrk's data_collection wrote out, measured_q1 ... q6.

Columns of joints.csv are ``frame`` (text: "0026" is not "26"), ``time`` in seconds, or both, and any of the joints.
data_collection writes ``# Topic:`` and ``# Type:``, then ``timestamp`` (ns) and a message's fields as columns:
``name.0 ...``, ``position.0 ...``. A table with ``measured_q1 ... q6`` has no jaw; its ``measured_x, y, z`` is a point
of the arm, not of the tip, and is not used.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.csv_file import Rows, read_csv_rows
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.names import ARM_ORDER, check_joint, ordered_joints, plain_joint
from dvrk_cmaes.joints.rows import JointFile, JointRow
from dvrk_cmaes.joints.times import parse_time

EXPECTED = "joint readings (joints.csv, or name=value,name=value)"

_MEASURED = tuple(f"measured_q{k}" for k in range(1, 7))
_COMMENT = re.compile(r"#\s*(\w+):\s*(\S*)")


def read_joint_csv(path: str, text: str, names: Sequence[str]) -> JointFile:
    """Read a CSV of any of these kinds, told by its header; ``names`` are the joints that may be read.

    Raises
    ------
    InputError
        Naming the file and the line, and what was expected.
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
        return _measured(path, header, rows)
    if "timestamp" in header:
        return _topic(path, header, rows, comments, names)
    return _own(path, header, rows, names)


def _own(path: str, header: list[str], rows: Rows, names: Sequence[str]) -> JointFile:
    """Rows of a joints.csv."""
    if "frame" not in header and "time" not in header:
        raise InputError(f"{path}: header: expected a column frame and columns of joints, got {listed(header)}")
    for name in header:
        if name not in ("frame", "time"):
            check_joint(f"{path}: header", name, names)
    found: dict[str, JointRow] = {}
    for count, (where, cells) in enumerate(rows):
        label = cells.pop("frame", f"row {count + 1}")
        clock = cells.pop("time", "")
        if not label:
            raise InputError(f"{where}: frame: expected a name, got a blank cell")
        if label in found:
            raise InputError(f"{where}: frame: expected each frame once, got {shown(label)} again")
        time = parse_time(where, clock) if clock else None
        found[label] = JointRow(f"{path}: frame {label}" if "frame" in header else where, cells, time)
    if not found:
        raise InputError(f"{path}: expected a row for each frame, got a header only")
    return JointFile(path, "joints.csv", found, "frame" if "frame" in header else "message")


def _measured(path: str, header: list[str], rows: Rows) -> JointFile:
    """Rows with measured_q1 ... measured_q6, numbered by ``traj_index`` or else by their place."""
    clocks = [name for name in ("time", "timestamp") if name in header]
    found: dict[str, JointRow] = {}
    for count, (where, cells) in enumerate(rows):
        label = _whole(where, "traj_index", cells["traj_index"]) if "traj_index" in cells else str(count)
        if label in found:
            raise InputError(f"{where}: traj_index: expected each number once, got {label} again")
        values = {joint: cells[name] for joint, name in zip(ARM_ORDER, _MEASURED, strict=True)}
        time = parse_time(where, cells[clocks[0]]) if clocks and cells[clocks[0]] else None
        found[label] = JointRow(where, values, time)
    if not found:
        raise InputError(f"{path}: expected a row for each frame, got a header only")
    notes = (f"measured_q1 to measured_q6 are taken as {', '.join(ARM_ORDER)}; the jaw is not among them",)
    return JointFile(path, "measured_q1 to measured_q6 (CSV)", found, "number", notes)


def _whole(where: str, name: str, cell: str) -> str:
    """Text of a whole number, which may be written as 26.0."""
    try:
        number = float(cell)
        if number == int(number):
            return str(int(number))
    except (ValueError, OverflowError):
        pass
    raise InputError(f"{where}: {name}: expected a whole number, got {shown(cell)}")


def _timestamp(where: str, cell: str) -> int:
    """Time in ns of a message; data_collection writes whole nanoseconds, however few."""
    return int(cell) if cell.isdecimal() and len(cell) < 19 else parse_time(where, cell)


def _topic(path: str, header: list[str], rows: Rows, comments: dict[str, str], names: Sequence[str]) -> JointFile:
    """Messages of a topic, as data_collection writes them."""
    kind = comments.get("type", "")
    if kind and not kind.endswith("/JointState"):
        raise InputError(f"{path}: # Type: expected sensor_msgs/JointState, got {shown(kind)}")
    columns = [name for name in header if re.fullmatch(r"position\.\d+", name)]
    if not columns:
        raise InputError(f"{path}: header: expected columns position.0, ..., got {listed(header)}")
    found: dict[str, JointRow] = {}
    for count, (where, cells) in enumerate(rows):
        filled = [name for name in columns if cells[name]]
        told = [cells.get(name.replace("position", "name"), "") for name in filled]
        if any(told):
            joints = tuple(plain_joint(name, names) for name in told)
            for joint in joints:
                check_joint(where, joint, names)
        else:
            joints = ordered_joints(f"{where}: position", len(filled))
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
