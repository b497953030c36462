"""Choice of a recording's keyframes: frames well in view, far from each other in time and in the arm's pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS

MOST_KEYFRAMES: Final = 60
LEAST_KEYFRAMES: Final = 12
"""Usable frames from which on a recording is solved by keyframes."""

_LEAST_AREA = 0.5  # of the median area of the masks, from which on a frame is well in view
_MOST_BORDER = 0.3  # share of a mask's contour that may lie on the image's border
_UNITS = {
    "insertion": 0.01,
    "roll": 0.5,
    "yaw": 0.05,
    "pitch": 0.05,
    "ecm_insertion": 0.01,
    "ecm_roll": 0.1,
    "ecm_yaw": 0.05,
    "ecm_pitch": 0.05,
}  # m and rad, of as different poses as
_JOINT_UNIT = 0.4  # rad, of the instrument's own joints
_TIME_UNITS = 8.0  # of the whole recording


def solved_with(config: EstimateConfig) -> EstimateConfig:
    """Return the settings with which keyframes are solved: they are far from each other, so each counts."""
    return replace(config, session=replace(config.session, alike_seconds=0.0))


@dataclass(frozen=True)
class MaskShape:
    """Area of a mask, px, and the share of its contour that lies on the image's border."""

    area: float
    on_border: float

    @classmethod
    def of(cls, mask: Bool) -> MaskShape:
        """Measure a mask (H, W)."""
        area = int(np.count_nonzero(mask))
        if not area:
            return cls(0.0, 1.0)
        border = sum(int(np.count_nonzero(side)) for side in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
        pixels = np.ascontiguousarray(mask).view(np.uint8)
        inner = cv2.erode(pixels, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
        inside = area - int(np.count_nonzero(inner))
        return cls(float(area), border / max(border + inside, 1))


def well_in_view(shapes: list[MaskShape]) -> Bool:
    """Return which of N frames (N,) show enough of the instrument, not mostly cut by the image's border."""
    area = np.array([shape.area for shape in shapes])
    if not area.any():
        return np.zeros(len(area), np.bool_)
    border = np.array([shape.on_border for shape in shapes])
    return np.asarray((area >= _LEAST_AREA * np.median(area[area > 0])) & (border <= _MOST_BORDER))


def choose_keyframes(
    usable: Bool, times: Float64, joint_names: tuple[str, ...], readings: Float64, most: int = MOST_KEYFRAMES
) -> list[int]:
    """Choose at most some frames, greedily that one which is farthest from all chosen before.

    Parameters
    ----------
    usable : (N,)
        The frames that may be chosen.
    times : (N,)
        Times of the frames.
    joint_names, readings : (N, K)
        The joints that are read, and their readings, rad and m; NaN where there is none.
    most
        Largest number of frames.

    Returns
    -------
    list of int
        The frames' numbers, increasing.
    """
    candidates = np.flatnonzero(usable)
    if len(candidates) <= most:
        return candidates.tolist()
    units = distance_units(joint_names)
    duration = max(float(np.ptp(times)), 1e-12)
    place = np.column_stack([np.nan_to_num(readings) / units, (times - times[0]) / duration * _TIME_UNITS])
    place = place[candidates]
    middle = int(np.argmin(np.linalg.norm(place - np.median(place, axis=0), axis=1)))
    return sorted(candidates[farthest_first(place, [middle], most)].tolist())


def farthest_first(places: Float64, chosen: Sequence[int], most: int) -> list[int]:
    """Return the indices of some places (N, D) that were chosen, and each time that of the one farthest from them."""
    found, distance = list[int](), np.full(len(places), np.inf)
    while len(found) < min(max(most, len(chosen)), len(places)):
        found.append(chosen[len(found)] if len(found) < len(chosen) else int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(places - places[found[-1]], axis=1))
        distance[found[-1]] = -1.0
    return found


def distance_units(joint_names: tuple[str, ...]) -> Float64:
    """Return the changes (K,) of joints, rad and m, by which poses of the arm are equally different."""
    return np.array([_UNITS.get(name, _JOINT_UNIT) for name in joint_names])


def has_outer_joints(joint_names: tuple[str, ...], readings: Float64) -> Bool:
    """Return which of N frames (N,) have readings (N, K) of all outer joints."""
    if not set(OUTER_JOINTS) <= set(joint_names):
        return np.zeros(len(readings), np.bool_)
    index = [joint_names.index(name) for name in OUTER_JOINTS]
    return np.asarray(~np.isnan(readings[:, index]).any(axis=1))
