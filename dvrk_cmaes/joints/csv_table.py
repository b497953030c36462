"""Reader of joint readings as CSV.

These formats are read:

- joints.csv of a session: columns ``frame`` (text: "0026" is not "26"), ``time`` in seconds, or both, and any joints.
  A large one of plain names, times and numbers is read by columns: an hour at 1 kHz is 3.6 million rows.
- a topic written by jhu-dvrk's data_collection: comment lines ``# Topic:`` and ``# Type:``, then the columns
  ``timestamp`` (ns) and a message's fields, ``name.0 ...`` and ``position.0 ...``.
- a table with a column of times (``time``, ``timestamp``, ``time_ms``) or no labels at all, and columns of joints,
  which may have ROS prefixes. Without a header, the columns are named by the user.
- tables of other tools: `rostopic echo -p` (``%time``, ``field.name0``, ``field.position0``), PlotJuggler (``__time``,
  ``/PSM1/measured_js/yaw/position``), tables with units in the names (``yaw_deg``, ``insertion [mm]``), with two
  columns of a time (``sec``, ``nanosec``), with each image's file in place of a frame's name, with columns without
  names, and with ``q1`` to ``q6`` in the dVRK's order.
- a table with the columns ``measured_q1`` to ``measured_q6``, without the jaw. Its columns ``measured_x, y, z`` are a
  point of the arm, not the tip, and are not used.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.inverse_kinematics import POSED_JOINTS
from dvrk_cmaes.io.csv_file import Rows, read_csv_rows
from dvrk_cmaes.io.short_text import is_number, listed, shown
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.joint_state import file_of_messages
from dvrk_cmaes.joints.names import joint_reading, joints_of_arm
from dvrk_cmaes.joints.rows import NO_TIME, JointFile, JointRow, ReadAs, RowNames
from dvrk_cmaes.joints.times import parse_time, parse_times, time_column

_FIELD: Final = re.compile(r"field\.(name|position)(\d+)")
_PLOTTED: Final = re.compile(r"/(?:(\w+)/)?(?:\w+/)*?(\w+)/position")
_PLOTTED_UNREAD: Final = re.compile(r"/.*/(?:velocity|effort)")
_UNIT: Final = re.compile(r"(\w+?)(?:_| *\[| *\()(deg|degrees?|rad|mm|cm|m|s|sec|ms|us|ns)[\])]?", re.IGNORECASE)
_ANGLES: Final = {"deg": math.pi / 180, "rad": 1.0}
_LENGTHS: Final = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_TIMES: Final = ("time", "timestamp", "stamp", "t")
_SECONDS: Final = re.compile(r"((?:.*\.)?)(secs?)")
_REST: Final = ("nanosec", "nsecs", "nsec", "nanosecs")
_FRAMES: Final = ("filename", "file_name", "file", "image", "image_name", "img", "frame_name", "frame_number")
_PICTURE: Final = re.compile(r"(.*)\.(?:png|jpe?g|bmp|tiff?)", re.IGNORECASE | re.DOTALL)
_NUMBERED: Final = {f"q{k}": name for k, name in enumerate(POSED_JOINTS, 1)} | {"jaw_angle": "jaw"}
_WITHOUT_NAME: Final = re.compile(r"|Unnamed: \d+")


def usual(header: Sequence[str], rows: Rows) -> tuple[list[str], Rows]:
    """Return header and rows of a table with the names, units and cells that `csv_table` reads; others as they are.

    Columns that are not read, and those without a name, are left out. A column of images' files is taken for that of
    frames, without the files' folders and suffixes. A column of seconds and one of nanoseconds are joined. Columns
    whose names have a unit are converted, of which that of a time stays at the end of its name.
    """
    rename = _of_rostopic if "%time" in header else _of_plotjuggler if "__time" in header else str
    names = {old: new for old in header if (new := rename(old)) is not None and not _WITHOUT_NAME.fullmatch(new)}
    if names.keys() >= _NUMBERED.keys() - {"jaw_angle"}:
        names = {old: _NUMBERED.get(new, new) for old, new in names.items()}
    if (split := _split_time(names, rows)) is not None:
        names = {"time": "time", **{old: new for old, new in names.items() if old not in split}}
        for _, cells in rows:
            cells["time"] = f"{cells[split[0]]}.{cells[split[1]]:0>9}"
    frame = next((old for old, new in names.items() if new == "frame"), None)
    frame = frame or next((old for old, new in names.items() if new.lower() in _FRAMES), None)
    factors = {}
    for old, new in names.items():
        if old == frame:
            names[old] = "frame"
        elif (match := _UNIT.fullmatch(new)) is not None:
            short = match[2].lower().removesuffix("rees").removesuffix("ree")
            factor = (_LENGTHS if match[1].endswith("insertion") else _ANGLES).get(short)
            if match[1].lower() in _TIMES:
                names[old] = f"{match[1]}_{short}"
            elif factor is not None:
                names[old], factors[old] = match[1], factor
    files = [None if frame is None else _PICTURE.fullmatch(cells[frame]) for _, cells in rows]
    stems = [PurePath(match[1].replace("\\", "/")).name for match in files if match is not None]
    if len(stems) == len(rows) and frame is not None:
        for (_, cells), stem in zip(rows, stems, strict=True):
            cells[frame] = stem
    renamed = ({new: _times(cells[old], factors.get(old, 1.0)) for old, new in names.items()} for _, cells in rows)
    return [*names.values()], [(where, own) for (where, _), own in zip(rows, renamed, strict=True)]


def _split_time(names: Mapping[str, str], rows: Rows) -> tuple[str, str] | None:
    """Return the columns of the seconds and of the nanoseconds of a time; None with a column of times, or without."""
    columns = {new: old for old, new in names.items()}
    if any(name.lower() in _TIMES for name in columns):
        return None
    for name, seconds in columns.items():
        match = _SECONDS.fullmatch(name)
        rest = None if match is None else next((columns[match[1] + e] for e in _REST if match[1] + e in columns), None)
        if rest is not None and all(
            cells[seconds].isdecimal() and cells[rest].isdecimal() and len(cells[rest]) <= 9 for _, cells in rows
        ):
            return seconds, rest
    return None


def _of_rostopic(name: str) -> str | None:
    """Return the name of a column of `rostopic echo -p` as data_collection has it; None for one that is not read."""
    field = _FIELD.fullmatch(name)
    return "timestamp" if name == "%time" else None if field is None else f"{field[1]}.{field[2]}"


def _of_plotjuggler(name: str) -> str | None:
    """Return the name of a column of PlotJuggler; None for one that is not read."""
    plotted = _PLOTTED.fullmatch(name)
    if plotted is not None:
        arm = plotted[1] or ""
        return f"{arm}_{plotted[2]}" if arm.upper().startswith(("PSM", "ECM", "MTM")) else plotted[2]
    return "time" if name == "__time" else None if _PLOTTED_UNREAD.fullmatch(name) else name


def _times(cell: str, factor: float) -> str:
    """Multiply the number in a cell; another cell stays as it is, and is refused where it is read."""
    return repr(float(cell) * factor) if factor != 1.0 and is_number(cell) else cell


LEAST = 1_000_000
"""Bytes of a table from which on it is read by columns, if it can be."""

_CHUNK = 1 << 23  # bytes that are read at once
_PLAIN: Final = (("time",), ("frame",), ("frame", "time"))
_UNUSUAL = (b'"', b" ", b"\t", b"\0")
_WIDTH = 24  # bytes of a name or a time
_LATEST = 4_000_000_000  # s; larger times may be in another unit
_DIGITS = 9  # of a time behind the point


def read_plain_table(path: str, data: bytes, names: Sequence[str]) -> JointFile | None:
    """Read a table whose header is ``frame``, ``time`` or both, and joints; None for any other table.

    That is read or refused by `read_joint_csv`. Times are exact to the nanosecond; a blank cell and ``nan`` are missing
    readings. ``names`` are those of the joints that are accepted. InputError names the line of a reading in another
    unit.
    """
    begin = data.find(b"\n") + 1
    header = [name.strip() for name in data[:begin].removeprefix(b"\xef\xbb\xbf").decode("ascii", "replace").split(",")]
    keys = tuple(name for name in header[:2] if name in _PLAIN[-1])
    joints = tuple(header[len(keys) :])
    if keys not in _PLAIN or not joints or len({*joints}) < len(joints) or not {*joints} <= {*names}:
        return None
    most = data.count(b"\n", begin) + 1
    labels, times = np.empty(most, f"S{_WIDTH}"), np.full(most, NO_TIME)
    values, count = np.empty((most, len(joints))), 0
    while begin < len(data):
        end = data.rfind(b"\n", begin, begin + _CHUNK) + 1 or len(data)
        rows = _plain_rows(data[begin:end].replace(b"\r\n", b"\n"), keys, len(joints))
        moments = None if rows is None else _exact_times(rows["time"]) if "time" in keys else NO_TIME
        if rows is None or moments is None:
            return None
        part = slice(count, count + len(rows))
        labels[part], times[part], values[part] = rows[keys[0]], moments, rows["values"]
        begin, count = end, part.stop
    labels, times, values = labels[:count], times[:count], values[:count]
    if "time" in keys and not (np.diff(times) > 0).all():
        return None
    for place in np.flatnonzero(~np.isnan(values).all(axis=0)):
        for worst in (np.nanargmax(values[:, place]), np.nanargmin(values[:, place])):
            try:
                joint_reading(f"{path}: line {worst + 2}", joints[place], float(values[worst, place]))
            except InputError:
                if "frame" in keys:  # the other rows are read
                    return None
                raise
    if "frame" not in keys:
        return JointFile(path, "joints.csv", "message", {}, joints, times, values)
    rows_of = RowNames(labels)
    return JointFile(path, "joints.csv", "frame", rows_of, joints, times, values) if rows_of.differ else None


def _plain_rows(chunk: bytes, keys: Sequence[str], joints: int) -> NDArray[np.void] | None:
    """Return whole rows of a table: its ``keys`` as bytes, and ``values`` (N, J); None if a row is not plain."""
    if not chunk.isascii() or any(mark in chunk for mark in _UNUSUAL):
        return None
    while b",," in chunk:
        chunk = chunk.replace(b",,", b",nan,")
    chunk = chunk.replace(b",\n", b",nan\n")
    kinds = [*((key, f"S{_WIDTH}") for key in keys), ("values", np.float64, (joints,))]
    try:
        rows = np.loadtxt(io.BytesIO(chunk), kinds, comments=None, delimiter=",", ndmin=1)
    except ValueError:
        return None
    is_whole = len(rows) == chunk.count(b"\n") + (not chunk.endswith(b"\n"))
    widths = [np.strings.str_len(rows[key]) for key in keys]
    return rows if is_whole and all((own.min() > 0) & (own.max() < _WIDTH) for own in widths) else None


def _exact_times(cells: NDArray[np.bytes_]) -> NDArray[np.int64] | None:
    """Return times of seconds with decimals (N,), ns; None if one is written otherwise."""
    whole, _, parts = np.strings.partition(cells, b".")
    if not (np.strings.isdigit(whole) & np.strings.isdigit(parts) & (np.strings.str_len(parts) <= _DIGITS)).all():
        return None
    seconds = whole.astype(np.int64)
    exact = seconds * NANOSECONDS + np.strings.ljust(parts, _DIGITS, b"0").astype(np.int64)
    return exact if seconds.max() <= _LATEST else None


EXPECTED = "joint readings (joints.csv, or name=value,name=value)"

_MEASURED = tuple(f"measured_q{k}" for k in range(1, 7))
_POSITION = re.compile(r"position\.\d+")
_COMMENT = re.compile(r"#\s*(\w+):\s*(\S*)")


def read_joint_csv(path: str, text: str, read_as: ReadAs) -> JointFile:
    """Read a CSV of any of these formats, recognised by its header.

    Parameters
    ----------
    path
        The file's path, for messages.
    text
        The file's content.
    read_as
        How it is read where it does not say it itself.

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
    header, rows = usual(*read_csv_rows(path, expected=EXPECTED, text=body, columns=read_as.columns))
    if "timestamp" in header and ("type" in comments or any(_POSITION.fullmatch(name) for name in header)):
        return _topic_table(path, header, rows, comments, read_as)
    return _joint_table(path, header, rows, read_as)


def _joint_table(path: str, header: list[str], rows: Rows, read_as: ReadAs) -> JointFile:
    """Read a joints.csv, or another table of joints: with frames, times, or, if its columns are named, neither.

    The rows of a table with measured_q1 to measured_q6 are labelled by ``traj_index``, or else by their number.
    """
    time, measured = time_column(path, header), {*_MEASURED} <= {*header}
    key = "traj_index" if measured else "frame"
    if key not in header and time is None and not measured and not read_as.columns:
        raise InputError(
            f"{path}: header: expected a column frame or time and columns of joints, got {listed(header)} (rows that "
            "are only counted are read with --columns and the names of the columns)"
        )
    joints = [name for name in header if name not in ("frame", time, "-")]
    if measured:
        columns = dict(zip(POSED_JOINTS, _MEASURED, strict=True))
    else:
        places = joints_of_arm(f"{path}: header", joints, read_as.names, read_as.arm)
        columns = {name: joints[k] for name, k in places.items()}
    times = parse_times(time, [(where, cells[time]) for where, cells in rows]) if time else [None] * len(rows)
    found: dict[str, JointRow] = {}
    for count, ((where, cells), moment) in enumerate(zip(rows, times, strict=True)):
        label = cells[key] if key in header else f"row {count + 1}" if time and not measured else str(count)
        if measured and key in header:
            label = _whole_number(where, key, label)
        if not label:
            raise InputError(f"{where}: frame: expected a name, got a blank cell")
        if label in found:
            what = "number" if measured else "frame"
            raise InputError(f"{where}: {key}: expected each {what} once, got {shown(label)} again")
        own = f"{path}: frame {label}" if key == "frame" and key in header else where
        found[label] = (own, {joint: cells[name] for joint, name in columns.items()}, moment)
    if not found:
        raise InputError(f"{path}: expected a row for each frame, got a header only")
    if measured:
        notes = (f"measured_q1 to measured_q6 are taken as {', '.join(POSED_JOINTS)}; the jaw is not among them",)
        return JointFile.of(path, "measured_q1 to measured_q6 (CSV)", found, "number", notes)
    return JointFile.of(path, "joints.csv", found, "frame" if key in header else "message" if time else "number")


def _whole_number(where: str, name: str, cell: str) -> str:
    """Return the decimal text of a whole number, which may be written as 26.0; InputError for other cells."""
    number = float(cell) if is_number(cell) else math.nan
    if not number.is_integer():
        raise InputError(f"{where}: {name}: expected a whole number, got {shown(cell)}")
    return str(int(number))


def _topic_table(path: str, header: list[str], rows: Rows, comments: dict[str, str], read_as: ReadAs) -> JointFile:
    """Read the messages of a topic as data_collection writes them; those without positions are skipped."""
    kind = comments.get("type", "")
    if kind and not kind.endswith("/JointState"):
        raise InputError(f"{path}: # Type: expected sensor_msgs/JointState, got {shown(kind)}")
    columns = [name for name in header if _POSITION.fullmatch(name)]
    if not columns:
        raise InputError(f"{path}: header: expected columns position.0, ..., got {listed(header)}")
    messages = []
    for where, cells in rows:
        filled = [name for name in columns if cells[name]]
        stated = [cells.get(name.replace("position", "name"), "") for name in filled]
        stamp = cells["timestamp"]  # data_collection writes whole nanoseconds, also for small numbers
        time = parse_time(where, stamp, 1 if stamp.isdecimal() else None) if filled else None
        messages.append((where, stated if any(stated) else [], [cells[name] for name in filled], time))
    described = f"JointState topic {comments.get('topic') or ''}".rstrip() + " (data_collection CSV)"
    return file_of_messages(path, described, messages, read_as)
