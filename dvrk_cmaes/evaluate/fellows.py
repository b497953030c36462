"""Frames whose base of the arm lies far from that of a session's other frames.

The base does not move during a session, so each frame's camera_from_base should have one rotation. A frame that differs
is in another mode, or its readings are of another time. How far is far depends on the session: a roll that is read
wrongly turns the base about another axis in each frame.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dvrk_cmaes.evaluate.consistency import spread_of_bases
from dvrk_cmaes.results.result import Result

FEWEST = 5
"""Least number of frames whose bases are compared."""

PREFIX = "base far from the others'"
"""Beginning of the reason of a frame that differs."""

_SPREADS = 3.0  # median distances from the most central base, beyond which a frame differs


def base_doubts(results: Mapping[str, Result], limit_deg: float) -> dict[str, str]:
    """Return the reason, in words, of each frame whose base is far from the others', by name.

    Compared are the frames that were solved by themselves and have a base. Far is a rotation from the most central base
    by more than ``limit_deg`` and by more than three times the median of all frames.
    """
    bases = {
        name: one.camera_from_base
        for name, one in results.items()
        if one.camera_from_base is not None and one.source == "frame"
    }
    if len(bases) < FEWEST:
        return {}
    angles = spread_of_bases(np.stack(list(bases.values()))).angles_deg
    limit = max(limit_deg, _SPREADS * float(np.median(angles)))
    return {
        name: f"{PREFIX}: rotated by {angle:.0f} deg, expected at most {limit:.0f} deg; another mode, or wrong readings"
        for name, angle in zip(bases, angles, strict=True)
        if angle > limit
    }
