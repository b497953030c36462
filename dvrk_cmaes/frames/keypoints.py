"""Jaw tips marked in the image: given as ``u1,v1,u2,v2``, or listed by frame in a session's keypoints.csv."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.csv_file import read_csv_rows
from dvrk_cmaes.io.short_text import is_number, listed, shown

_COLUMNS = ("frame", "tip_1_u", "tip_1_v", "tip_2_u", "tip_2_v")


def parse_keypoints(text: str) -> Float64:
    """Parse the pixels of the two tips, in either order, to (2, 2): a row (u, v) each.

    Raises
    ------
    InputError
        Not four finite numbers.
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 4:
        raise InputError(f"keypoints: expected four numbers u1,v1,u2,v2 in pixels, got {len(parts)} ({shown(text)})")
    for part in parts:
        if not (is_number(part) and math.isfinite(float(part))):
            raise InputError(f"keypoints: expected four finite numbers u1,v1,u2,v2 in pixels, got {shown(part)}")
    return np.array([float(part) for part in parts]).reshape(2, 2)


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
    tips: dict[str, Float64] = {}
    for where, cells in rows:
        frame, *numbers = cells.values()
        if not frame:
            raise InputError(f"{where}: expected a frame and four numbers, got {listed(cells.values())}")
        if frame in tips:
            raise InputError(f"{where}: frame: expected each frame once, got {shown(frame)} again")
        if any(numbers):
            try:
                tips[frame] = parse_keypoints(",".join(numbers))
            except InputError as error:
                raise InputError(f"{where}: {error}") from None
    return tips
