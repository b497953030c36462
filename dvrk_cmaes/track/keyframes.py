"""Keyframes of a recording, and those that a tracker keeps: images well in view, far from each other in time and pose.

When a tracker has too many, one of the two that are nearest to each other is dropped, so that they stay spread over all
that was seen.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.model import ecm_readings
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.track.keyframe_problem import Keyframe
from dvrk_cmaes.track.reading_buffer import ReadingBuffer

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


SOLVED_AT: Final = (4, 8, 12, 16, 20, 24, 36, 48, MOST_KEYFRAMES)
"""Numbers of keyframes at which they are solved together."""

NEW_AT_MOST: Final = 20
"""Of the largest number of keyframes, those that are new since they were last solved, at which they are solved anew."""

_LEAST_APART = 0.15  # of `distance_units`, between two keyframes
_LEAST_SECONDS = 0.09  # between two keyframes
_SECONDS = 4.0  # of as different images as one of `distance_units`
_SHAPES = 200  # masks whose areas tell what is well in view


class KeyframeStore:
    """Keyframes of what is followed; ``readings`` keep those around them.

    ``taken`` is the number of images that were kept so far, whether they still are or not.
    """

    def __init__(self, rig: Rig, joint_names: tuple[str, ...], readings: ReadingBuffer) -> None:
        self._rig, self._readings = rig, readings
        self._names = (*OUTER_JOINTS, *joint_names, *ECM_JOINTS)
        self.taken = 0
        self._kept: list[Keyframe] = []
        self._places = np.zeros((0, len(self._names) + 1))
        self._shapes: list[MaskShape] = []
        self._measured: tuple[Bool, MaskShape] | None = None  # the last mask
        self._last: float | None = None
        self._interval: list[float] = []

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def steered(self) -> bool:
        """Whether the arm of the endoscope is read, and has moved between keyframes."""
        return Steered.of(ecm_readings([one.readings for one in self._kept])) is not None

    def clear(self) -> None:
        """Forget all keyframes: those that follow are of another base."""
        self._kept, self._places, self._readings.near = [], self._places[:0], []

    def shows_well(self, masks: Mapping[str, Bool]) -> bool:
        """Return whether an image's masks, by view, show enough of the instrument, by those that were offered."""
        mask = self._first_of(masks)
        return mask is not None and bool(well_in_view([*self._shapes, self._shape_of(mask)])[-1])

    def _shape_of(self, mask: Bool) -> MaskShape:
        """Measure a mask, which may be the last one once more."""
        if self._measured is None or self._measured[0] is not mask:
            self._measured = mask, MaskShape.of(mask)
        return self._measured[1]

    def _first_of(self, masks: Mapping[str, Bool]) -> Bool | None:
        """Return the mask (H, W) of the first view that has one."""
        mask = next((masks[name] for name in self._rig.names if name in masks), None)
        return mask if mask is not None and mask.any() else None

    def is_new(self, time: float, readings: Mapping[str, float]) -> bool:
        """Whether an image of a time, s, with readings differs from all that are kept."""
        if not set(OUTER_JOINTS) <= set(readings) or (self._kept and time - self._kept[-1].time < _LEAST_SECONDS):
            return False
        return self._apart(self._place(time, readings)) >= _LEAST_APART

    def _apart(self, place: Float64) -> float:
        """Return how far a place is from the nearest keyframe, infinite without one."""
        return float(np.linalg.norm(self._places - place, axis=1).min(initial=np.inf))

    def _place(self, time: float, readings: Mapping[str, float]) -> Float64:
        """Return where an image lies among others, in units of the distance between keyframes."""
        values = np.array([readings.get(name, 0.0) for name in self._names])
        return np.array([*(values / distance_units(self._names)), time / _SECONDS])

    def offer(
        self,
        time: float,
        masks: Mapping[str, Bool],
        ignored: Mapping[str, Bool],
        readings: Mapping[str, float],
        rates: Mapping[str, float],
    ) -> bool:
        """Keep an image, if its masks, by view, show enough, and it differs from all that are kept; whether it is.

        ``readings`` are those at its ``time``, s, and ``rates`` theirs per s.
        """
        if self._last is not None:
            self._interval = [*self._interval[-50:], time - self._last]
        self._last = time
        mask = self._first_of(masks)
        if mask is None:
            return False
        self._shapes = [*self._shapes[-_SHAPES:], self._shape_of(mask)]
        if not well_in_view(self._shapes)[-1] or not self.is_new(time, readings):
            return False
        place = self._place(time, readings)
        if len(self._kept) >= MOST_KEYFRAMES and not self._drops_one(self._apart(place)):
            return False
        shown, hidden = ({name: np.packbits(mask) for name, mask in own.items()} for own in (masks, ignored))
        self._kept.append(Keyframe(time, shown, hidden, dict(readings), dict(rates)))
        self._places = np.vstack([self._places, place])
        self._readings.near = [keyframe.time for keyframe in self._kept]
        self.taken += 1
        return True

    def _drops_one(self, nearest: float) -> bool:
        """Drop one of the two keyframes that are nearest to each other, if they are nearer than ``nearest``."""
        apart = np.linalg.norm(self._places[:, None] - self._places, axis=2) + np.diag(np.full(len(self._kept), np.inf))
        closest = int(apart.min(axis=1).argmin())
        if apart[closest].min() >= nearest:
            return False
        del self._kept[closest]
        self._places = np.delete(self._places, closest, axis=0)
        return True

    @property
    def names(self) -> list[str]:
        """Names of the keyframes that are kept."""
        return [keyframe.name for keyframe in self._kept]

    def spread(self, most: int, first: Collection[str] = ()) -> list[Keyframe]:
        """Return at most some keyframes: those named ``first``, and each time that one which is farthest from them."""
        before = [index for index, keyframe in enumerate(self._kept) if keyframe.name in first]
        return [self._kept[index] for index in farthest_first(self._places, before, most)]

    def series(self, keyframes: Sequence[Keyframe]) -> ReadingSeries:
        """Return the readings that are kept, with the times of some keyframes."""
        times, values = dict[str, Float64](), dict[str, Float64]()
        for rows in filter(None, (self._readings, self._readings.ecm)):
            for name, column in zip(rows.series.joints, rows.series.values.T, strict=True):
                if (read := ~np.isnan(column)).any():
                    times[name], values[name] = rows.series.times[read], column[read]
        names = {keyframe.name: keyframe.time for keyframe in keyframes}
        interval = float(np.median(self._interval)) if self._interval else 1 / 30
        return ReadingSeries("s", times, values, names, interval)
