"""What is marked in the images of a session: jaw tips (keypoints.csv), and boxes and points (boxes.csv)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.csv_file import number_in, read_csv_rows, rows_by_frame
from dvrk_cmaes.io.short_text import listed

_FRAME = "frame"
_BOX = ("x0", "y0", "x1", "y1")
_POINT = ("u", "v")


@dataclass(frozen=True)
class Hints:
    """Box (left, top, right, bottom), px, around the instrument, None without one; pixels (u, v) on and beside it."""

    box: tuple[float, float, float, float] | None = None
    points: Sequence[tuple[float, float]] = ()
    not_points: Sequence[tuple[float, float]] = ()


def read_boxes(path: str | Path) -> dict[str, Hints]:
    """Read a boxes.csv: columns ``frame`` and ``x0, y0, x1, y1`` (a box), ``u, v`` (a point), or both; px.

    Blank cells of a box or a point mean that the frame has none.

    Raises
    ------
    InputError
        Naming the file, the line and the column, and what was expected.
    """
    header, rows = read_csv_rows(path, expected="boxes around the instrument (boxes.csv)")
    parts = [part for part in (_BOX, _POINT) if set(part) <= set(header)]
    if _FRAME not in header or not parts or set(header) - {_FRAME, *(name for part in parts for name in part)}:
        raise InputError(f"{path}: header: expected frame,x0,y0,x1,y1 or frame,u,v or both, got {listed(header)}")
    prompts: dict[str, Hints] = {}
    for frame, (where, cells) in rows_by_frame(rows).items():
        box, point = (_numbers(where, part, cells) if part in parts else () for part in (_BOX, _POINT))
        if box and not (box[0] < box[2] and box[1] < box[3]):
            raise InputError(f"{where}: expected a box with x0 < x1 and y0 < y1, got {listed(map(str, box))}")
        prompts[frame] = Hints(
            (box[0], box[1], box[2], box[3]) if box else None, ((point[0], point[1]),) if point else ()
        )
    return prompts


def _numbers(where: str, names: tuple[str, ...], cells: dict[str, str]) -> tuple[float, ...]:
    """Return the numbers in some columns of a row; empty if all cells are blank."""
    if not any(cells[name] for name in names):
        return ()
    return tuple(number_in(where, name, cells) for name in names)


_COLUMNS = ("frame", "tip_1_u", "tip_1_v", "tip_2_u", "tip_2_v")


def read_keypoints(path: str | Path) -> dict[str, Float64]:
    """Read a keypoints.csv: the two tips (2, 2) px of each frame that has them, by frame.

    Columns ``frame, tip_1_u, tip_1_v, tip_2_u, tip_2_v``; the cells of a frame whose tips are not known are blank.

    Raises
    ------
    InputError
        Naming the file and the line, and what was expected.
    """
    header, rows = read_csv_rows(path, expected="jaw tips (keypoints.csv)")
    if header != list(_COLUMNS):
        raise InputError(f"{path}: header: expected {','.join(_COLUMNS)}, got {listed(header) or 'nothing'}")
    read = {frame: _numbers(where, _COLUMNS[1:], cells) for frame, (where, cells) in rows_by_frame(rows).items()}
    return {frame: np.array(numbers).reshape(2, 2) for frame, numbers in read.items() if numbers}
