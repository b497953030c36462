"""The few of a long session's frames that tell nearly as much as all of them where not every frame's own fit is needed.

Frames of a recording that follow each other closely err alike, so that what they tell of the constants grows much more
slowly than their number. What only leads to the constants' final estimate is therefore found with a limited number of
frames, evenly spaced; the final estimate is always from all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.consensus import evenly_spaced

_FEW = 100
"""Number of frames that are enough on the way to an estimate."""

_PAYS = 2
"""Multiple of this number, below which all frames are used."""


def few_of(count: int) -> NDArray[np.intp] | None:
    """Return the indices of a few of ``count`` frames in their order, evenly spaced; None where all are to be used.

    Parameters
    ----------
    count
        Number of the session's frames.
    """
    return evenly_spaced(count, _FEW) if count >= _PAYS * _FEW else None
