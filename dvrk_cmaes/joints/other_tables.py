"""Tables of readings as other tools write them, in the columns of this project's.

These are `rostopic echo -p` (``%time``, ``field.name0``, ``field.position0``), PlotJuggler (``__time``,
``/PSM1/measured_js/yaw/position``), tables with units in the names (``yaw_deg``, ``insertion [mm]``), with two columns
of a time (``sec``, ``nanosec``), with each image's file in place of a frame's name, and with columns without names.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import PurePath
from typing import Final

from dvrk_cmaes.io.csv_file import Rows

_FIELD: Final = re.compile(r"field\.(name|position)(\d+)")
_PLOTTED: Final = re.compile(r"/(?:(\w+)/)?(?:\w+/)*?(\w+)/position")
_PLOTTED_BESIDE: Final = re.compile(r"/.*/(?:velocity|effort)")
_UNIT: Final = re.compile(r"(\w+?)(?:_| *\[| *\()(deg|degrees?|rad|mm|cm|m|s|sec|ms|us|ns)[\])]?", re.IGNORECASE)
_ANGLES: Final = {"deg": math.pi / 180, "rad": 1.0}
_LENGTHS: Final = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_TIMES: Final = ("time", "timestamp", "stamp", "t")
_SECONDS: Final = re.compile(r"((?:.*\.)?)(secs?)")
_REST: Final = ("nanosec", "nsecs", "nsec", "nanosecs")
_FRAMES: Final = ("filename", "file_name", "file", "image", "image_name", "img", "frame_name", "frame_number")
_PICTURE: Final = re.compile(r"(.*)\.(?:png|jpe?g|bmp|tiff?)", re.IGNORECASE | re.DOTALL)
_WITHOUT_NAME: Final = re.compile(r"|Unnamed: \d+")


def usual(header: Sequence[str], rows: Rows) -> tuple[list[str], Rows]:
    """Return header and rows of a table with the names, units and cells that `csv_table` reads; others as they are."""
    if "%time" in header:
        header, rows = _renamed(header, rows, _of_rostopic)
    elif "__time" in header:
        header, rows = _renamed(header, rows, _of_plotjuggler)
    header, rows = _renamed(header, rows, lambda name: None if _WITHOUT_NAME.fullmatch(name) else name)
    header, rows = _one_time(header, rows)
    header, rows = _with_frames(header, rows)
    return _in_radians_and_metres(header, rows)


def _renamed(header: Sequence[str], rows: Rows, new: Callable[[str], str | None]) -> tuple[list[str], Rows]:
    """Return a table with other names of its columns, without those for which there is none."""
    names = {name: new(name) for name in header}
    if all(name == other for name, other in names.items()):
        return list(header), rows
    kept = [(name, other) for name, other in names.items() if other is not None]
    return [other for _, other in kept], [
        (where, {other: cells[name] for name, other in kept}) for where, cells in rows
    ]


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
    return "time" if name == "__time" else None if _PLOTTED_BESIDE.fullmatch(name) else name


def _one_time(header: Sequence[str], rows: Rows) -> tuple[list[str], Rows]:
    """Join a column of seconds and one of nanoseconds, where there is no column of times."""
    if any(name.lower() in _TIMES for name in header):
        return list(header), rows
    for name in header:
        match = _SECONDS.fullmatch(name)
        rest = None if match is None else next((match[1] + end for end in _REST if match[1] + end in header), None)
        if rest is None:
            continue
        others = [other for other in header if other not in (name, rest)]
        whole = [cells[name].isdecimal() and cells[rest].isdecimal() and len(cells[rest]) <= 9 for _, cells in rows]
        if all(whole):
            joined = (f"{cells[name]}.{cells[rest]:0>9}" for _, cells in rows)
            return ["time", *others], [
                (where, {"time": time, **{other: cells[other] for other in others}})
                for time, (where, cells) in zip(joined, rows, strict=True)
            ]
    return list(header), rows


def _with_frames(header: Sequence[str], rows: Rows) -> tuple[list[str], Rows]:
    """Take the column of images' files for that of frames, and leave the folders and suffixes of files out."""
    column = "frame" if "frame" in header else next((name for name in header if name.lower() in _FRAMES), None)
    if column is None:
        return list(header), rows
    header, rows = _renamed(header, rows, lambda name: "frame" if name == column else name)
    pictures = [_PICTURE.fullmatch(cells["frame"]) for _, cells in rows]
    if not all(pictures):
        return header, rows
    stems = [PurePath(match[1].replace("\\", "/")).name for match in pictures if match is not None]
    return header, [(where, {**cells, "frame": stem}) for stem, (where, cells) in zip(stems, rows, strict=True)]


def _in_radians_and_metres(header: Sequence[str], rows: Rows) -> tuple[list[str], Rows]:
    """Convert columns whose names have a unit, of which that of a time stays at the end of its name."""
    units = {name: match for name in header if (match := _UNIT.fullmatch(name)) is not None}
    names, factors = {}, {}
    for name, match in units.items():
        short = match[2].lower().removesuffix("rees").removesuffix("ree")
        factor = (_LENGTHS if match[1].endswith("insertion") else _ANGLES).get(short)
        if match[1].lower() in _TIMES:
            names[name] = f"{match[1]}_{short}"
        elif factor is not None:
            names[name], factors[name] = match[1], factor
    converted = [
        (where, {name: _times(cell, factors.get(name, 1.0)) for name, cell in cells.items()}) for where, cells in rows
    ]
    return _renamed(header, converted if factors else rows, lambda name: names.get(name, name))


def _times(cell: str, factor: float) -> str:
    """Multiply the number in a cell; another cell stays as it is, and is refused where it is read."""
    try:
        return cell if factor == 1.0 else repr(float(cell) * factor)
    except ValueError:
        return cell
