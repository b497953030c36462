"""Jaw tips that a person points at: pixels written as ``u1,v1,u2,v2``."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.shown import shown


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
