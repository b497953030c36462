"""Prompts of a session's frames: where the instrument is in images without a mask, listed by frame in boxes.csv."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.csv_file import number_in, read_csv_rows
from dvrk_cmaes.io.short_text import listed, shown

_FRAME = "frame"
_BOX = ("x0", "y0", "x1", "y1")
_POINT = ("u", "v")


@dataclass(frozen=True)
class FramePrompts:
    """Box (left, top, right, bottom), px, around the instrument, None without one; pixels (u, v) on and beside it."""

    box: tuple[float, float, float, float] | None = None
    points: tuple[tuple[float, float], ...] = ()
    not_points: tuple[tuple[float, float], ...] = ()


def read_boxes(path: str | Path) -> dict[str, FramePrompts]:
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
    prompts: dict[str, FramePrompts] = {}
    for where, cells in rows:
        frame = cells[_FRAME]
        if not frame or frame in prompts:
            raise InputError(f"{where}: frame: expected each frame once, got {shown(frame)}{' again' if frame else ''}")
        box, point = (_numbers(where, part, cells) if part in parts else () for part in (_BOX, _POINT))
        if box and not (box[0] < box[2] and box[1] < box[3]):
            raise InputError(f"{where}: expected a box with x0 < x1 and y0 < y1, got {listed(map(str, box))}")
        prompts[frame] = FramePrompts(
            (box[0], box[1], box[2], box[3]) if box else None, ((point[0], point[1]),) if point else ()
        )
    return prompts


def _numbers(where: str, names: tuple[str, ...], cells: dict[str, str]) -> tuple[float, ...]:
    """Return the numbers in some columns of a row; empty if all cells are blank."""
    if not any(cells[name] for name in names):
        return ()
    return tuple(number_in(where, name, cells) for name in names)
