"""Two tools whose masks were exchanged: the joints found for each are nearer to the readings of the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from dvrk_cmaes.results.result import Result

FoundAndRead = tuple[Mapping[str, float], Mapping[str, float]]
"""The joints of a tool as found and as read in one frame, rad."""

_LEAST_FRAMES = 3
_FACTOR = 2.0  # of the squared distances from the own readings and from those of the other tool
_JOINTS = ("wrist_pitch", "wrist_yaw", "jaw")
_LEAST_BETTER = 0.75  # share of the frames in which the other's masks fit better
_LARGEST_RATIO = 0.85  # of the loss with the other's masks to that with the own ones, median
_LEAST_FOLLOWED = 15  # frames at the end of a recording
_LEAST_OFF = np.deg2rad(30)  # from the own readings there, of both tools together; more than cables explain


def exchanged_tools(results: Mapping[str, Mapping[str, Result]]) -> list[str]:
    """Say which tools seem to be exchanged, given the results of each arm by frame; empty without any.

    Two tools are compared in the frames in which both were found and read. The readings pull a pose towards them, so
    joints that are clearly nearer to the readings of the other tool are no accident.
    """
    found = []
    for first, second in combinations(results, 2):
        distances = _distances(_of_results(results[first]), _of_results(results[second]))
        if len(distances) < _LEAST_FRAMES:
            continue
        own, other = np.median(list(distances.values()), axis=0)
        if own > _FACTOR * other:
            found.append(_described(first, second, own, other))
    return found


def exchanged_while_followed(tracks: Mapping[str, Mapping[str, FoundAndRead]]) -> list[str]:
    """Say which followed tools seem to be exchanged, and from which frame on to the end; empty without any.

    ``tracks`` have the joints of each arm by frame, in the order of the frames, for those in which they were found and
    read. The first frame is that from which on the distances from the own readings exceed the others' most.
    """
    found = []
    for first, second in combinations(tracks, 2):
        distances = _distances(tracks[first], tracks[second])
        if len(distances) < _LEAST_FOLLOWED:
            continue
        names, values = list(distances), np.array(list(distances.values()))
        excess = np.cumsum((values[:, 0] - values[:, 1])[::-1])[::-1]
        start = int(np.argmax(excess[: len(names) - _LEAST_FOLLOWED + 1]))
        own, other = np.median(values[start:], axis=0)
        if own > _FACTOR * other and own > _LEAST_OFF**2:
            found.append(_described(first, second, own, other) + f" from frame {names[start]} on")
    return found


def masks_exchanged(losses: Sequence[tuple[float, float]]) -> bool:
    """Whether two tools have each other's masks, given the losses of frames with their masks and with the other's.

    A loss of a frame is the sum of those of both tools. Joints alone do not tell it: wrong readings pull a pose so much
    that it stays nearer to them than to those of the other tool.
    """
    if len(losses) < _LEAST_FRAMES:
        return False
    ratios = np.array([exchanged / own for own, exchanged in losses])
    return bool(np.mean(ratios < 1) >= _LEAST_BETTER and np.median(ratios) < _LARGEST_RATIO)


def describe_exchange(first: str, second: str, evidence: str) -> str:
    """Say that two tools seem to be exchanged, and why."""
    return f"{first} and {second}: {evidence}; their masks or readings seem to be exchanged"


def _described(first: str, second: str, own: float, other: float) -> str:
    """Say that two tools seem to be exchanged, given the squared distances from the own and the other's readings."""
    return describe_exchange(
        first,
        second,
        "the joints found for each are nearer to the readings of the other "
        f"({np.degrees(np.sqrt(other)):.0f} instead of {np.degrees(np.sqrt(own)):.0f} deg)",
    )


def _of_results(results: Mapping[str, Result]) -> dict[str, FoundAndRead]:
    """Return the joints of the results that have a pose and readings."""
    return {name: (one.joints, one.readings) for name, one in results.items() if one.joints and one.readings}


def _distances(first: Mapping[str, FoundAndRead], second: Mapping[str, FoundAndRead]) -> dict[str, tuple[float, float]]:
    """Return the squared distances of two tools' joints from the own and the other's readings, rad^2, by frame."""
    pairs = {name: (a, second[name]) for name, a in first.items() if name in second}
    return {
        name: (_distance(a[0], a[1]) + _distance(b[0], b[1]), _distance(a[0], b[1]) + _distance(b[0], a[1]))
        for name, (a, b) in pairs.items()
    }


def _distance(found: Mapping[str, float], read: Mapping[str, float]) -> float:
    """Return the summed squares of the distances of found joints from readings, rad^2."""
    names = [name for name in _JOINTS if name in found and name in read]
    return float(sum((found[name] - read[name]) ** 2 for name in names))
