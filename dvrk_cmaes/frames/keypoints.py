"""Jaw tips that a person or a detector points at: written as ``u1,v1,u2,v2``, or a session's keypoints.csv."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text
from dvrk_cmaes.io.short_text import listed, shown

_COLUMNS = ("frame", "tip_1_u", "tip_1_v", "tip_2_u", "tip_2_v")
_LARGEST = 100_000_000  # bytes


def parse_keypoints(text: str) -> NDArray[np.float64]:
    """Parse the two tips, in either order, to (2, 2): one row (u, v) each, pixels.

    Raises
    ------
    InputError
        Not four finite numbers.
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 4:
        raise InputError(f"keypoints: expected four numbers u1,v1,u2,v2 in pixels, got {len(parts)} ({shown(text)})")
    numbers = []
    for part in parts:
        try:
            number = float(part)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise InputError(f"keypoints: expected four finite numbers u1,v1,u2,v2 in pixels, got {shown(part)}")
        numbers.append(number)
    return np.array(numbers).reshape(2, 2)


def read_keypoints(path: str | Path) -> dict[str, NDArray[np.float64]]:
    """Read a keypoints.csv: the two tips (2, 2) px of each frame that has them, by frame.

    Columns ``frame, tip_1_u, tip_1_v, tip_2_u, tip_2_v``; a row of blank cells is a frame whose tips are not known.

    Raises
    ------
    InputError
        Naming the file and the line, and what was expected.
    """
    text = read_text(path, expected="jaw tips (keypoints.csv)", largest=_LARGEST)
    reader = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    found: dict[str, NDArray[np.float64]] = {}
    try:
        if reader.fieldnames is None or [name.strip() for name in reader.fieldnames] != list(_COLUMNS):
            raise InputError(f"{path}: header: expected {','.join(_COLUMNS)}, got {listed(reader.fieldnames or ())}")
        for row in reader:
            where = f"{path}: line {reader.line_num}"
            cells = [cell.strip() for cell in row.values() if isinstance(cell, str)]
            if len(cells) != len(_COLUMNS) or not cells[0]:
                raise InputError(f"{where}: expected a frame and four numbers, got {listed(cells)}")
            if cells[0] in found:
                raise InputError(f"{where}: frame: expected each frame once, got {shown(cells[0])} again")
            if any(cells[1:]):
                try:
                    found[cells[0]] = parse_keypoints(",".join(cells[1:]))
                except InputError as error:
                    raise InputError(f"{where}: {error}") from None
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: expected valid CSV, got {error}") from None
    return found
