"""Readings of the arm that are frozen: they stand still while the instrument moves."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]

_LEAST_FRAMES: Final = 5  # without any change of a reading, from which on it stands still
_LEAST_SHIFT: Final = 0.04  # of the image's width, by which a mask's centre moves where the instrument moves
_SAME = 1e-9  # rad and m


def frozen_frames(outer: Float64, centres: Float64, width: float) -> Bool:
    """Return at which of N frames (N,) the readings of the outer joints stand still while the mask moves.

    Parameters
    ----------
    outer : (N, 4)
        Readings of the outer joints, rad and m; NaN where there is none.
    centres : (N, 2)
        Centres of the masks, px; NaN without one.
    width
        Width of the images, px.
    """
    still = np.zeros(len(outer), np.bool_)
    change = np.abs(np.diff(outer, axis=0)).max(axis=1, initial=0.0) > _SAME
    starts = [0, *(np.flatnonzero(change | np.isnan(change)) + 1).tolist(), len(outer)]
    for first, last in pairwise(starts):
        seen = centres[first:last][~np.isnan(centres[first:last]).any(axis=1)]
        if last - first >= _LEAST_FRAMES and len(seen) >= _LEAST_FRAMES and not np.isnan(outer[first]).any():
            low, high = np.percentile(seen, [10, 90], axis=0)
            still[first:last] = bool((high - low).max() > _LEAST_SHIFT * width)
    return still


def describe_frozen(frozen: Bool, names: Sequence[str]) -> list[str | None]:
    """Return for each frame the reason that its readings are frozen; None where they are not."""
    texts: list[str | None] = []
    since = ""
    for i, name in enumerate(names):
        if frozen[i] and (i == 0 or not frozen[i - 1]):
            since = name
        texts.append(f"readings frozen since frame {since}: the mask moves, and they do not" if frozen[i] else None)
    return texts
