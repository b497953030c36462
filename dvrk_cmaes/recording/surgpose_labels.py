"""Labels and boxes of one arm of a SurgPose folder: which points and which box of each frame belong to it.

Of the labels' numbers, 1 to 7 are on PSM1 and 8 to 14 on PSM3. Boxes are of numbered tools: the box of an arm is that
with most of its labels.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera.fields import as_number
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import shown

Labels = dict[int, dict[str, tuple[float, float]]]
"""Pixels (u, v) by the label's number, as text, in each frame."""

Box = tuple[float, float, float, float]
"""Left, top, right, bottom, px."""

_NUMBERS: Final[Mapping[str, range]] = {"PSM1": range(1, 8), "PSM3": range(8, 15)}
_ALL: Final = range(1, 15)


def arm_labels(path: Path, rows: Mapping[int, Any], arm: str) -> Labels:
    """Return the labels of an arm from a document's values by frame; points that are null are left out.

    Raises
    ------
    InputError
        Naming the frame and the label, and what was expected.
    """
    own = _NUMBERS.get(arm, range(0))
    labels: Labels = {}
    for frame, row in rows.items():
        if row is None:
            continue
        if not isinstance(row, Mapping):
            raise InputError(f"{path}: frame {frame}: expected points by number, got {shown(row)}")
        for name, value in row.items():
            number = as_number(name)
            if number is None or number not in _ALL:
                raise InputError(f"{path}: frame {frame}: expected numbers of labels, 1 to 14, got {shown(name)}")
            if value is not None and number in own:
                where = f"{path}: frame {frame}: label {int(number)}"
                u, v = _numbers(where, value, 2, "[x, y] in pixels or null")
                labels.setdefault(frame, {})[str(int(number))] = (u, v)
    return labels


def arm_boxes(path: Path, rows: Mapping[int, Any], labels: Labels) -> dict[int, Box]:
    """Return the box with most of an arm's labels in each frame that has one; errors as in ``arm_labels``."""
    boxes: dict[int, Box] = {}
    for frame, row in rows.items():
        if row is None:
            continue
        if not isinstance(row, Mapping):
            raise InputError(f"{path}: frame {frame}: expected boxes by id, got {shown(row)}")
        points = np.array(list(labels.get(frame, {}).values())).reshape(-1, 2)
        most = 0
        for name, value in row.items():
            if value is None:
                continue
            expected = "[x, y, width, height] in pixels or null"
            x, y, width, height = _numbers(f"{path}: frame {frame}: box {shown(name)}", value, 4, expected)
            inside = int(((points >= [x, y]) & (points <= [x + width, y + height])).all(axis=1).sum())
            if width > 0 and height > 0 and inside > most:
                most, boxes[frame] = inside, (x, y, x + width, y + height)
    return boxes


def _numbers(where: str, value: Any, count: int, expected: str) -> list[float]:
    """Return a list of finite numbers; InputError otherwise."""
    numbers = [as_number(each) for each in value] if isinstance(value, list) else []
    found = [number for number in numbers if number is not None and np.isfinite(number)]
    if len(numbers) != count or len(found) != count:
        raise InputError(f"{where}: expected {expected}, got {shown(value)}")
    return found
