"""Two tools whose masks were exchanged: the joints found for each are nearer to the readings of the other."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from dvrk_cmaes.results.result import Result

_LEAST_FRAMES = 3
_FACTOR = 2.0  # of the squared distances from the own readings and from those of the other tool
_JOINTS = ("wrist_pitch", "wrist_yaw", "jaw")


def exchanged_tools(results: Mapping[str, Mapping[str, Result]]) -> list[str]:
    """Say which tools seem to be exchanged, given the results of each arm by frame; empty without any.

    Two tools are compared in the frames in which both were found and read. The readings pull a pose towards them, so
    joints that are clearly nearer to the readings of the other tool are no accident.
    """
    found = []
    for first, second in combinations(results, 2):
        frames = [
            (a, b)
            for name, a in results[first].items()
            if (b := results[second].get(name)) is not None and a.joints and b.joints and a.readings and b.readings
        ]
        if len(frames) < _LEAST_FRAMES:
            continue
        own = np.median([_distance(a, a) + _distance(b, b) for a, b in frames])
        other = np.median([_distance(a, b) + _distance(b, a) for a, b in frames])
        if own > _FACTOR * other:
            found.append(
                f"{first} and {second}: the joints found for each are nearer to the readings of the other "
                f"({np.degrees(np.sqrt(other)):.0f} instead of {np.degrees(np.sqrt(own)):.0f} deg); "
                "their masks or readings seem to be exchanged"
            )
    return found


def _distance(found: Result, read: Result) -> float:
    """Return the summed squares of the distances of found joints from the readings of a result, rad^2."""
    names = [name for name in _JOINTS if name in found.joints and name in read.readings]
    return float(sum((found.joints[name] - read.readings[name]) ** 2 for name in names))
