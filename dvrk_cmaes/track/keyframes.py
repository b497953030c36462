"""Keyframes of a recording, and those that a tracker keeps: images well in view, far from each other in time and pose.

When a tracker has too many, one of the two that are nearest to each other is dropped, so that they stay spread over all
that was seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.model import ecm_readings
from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.pose.doubts import readings_too_sparse
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.track.follower import Followed, Follower
from dvrk_cmaes.track.keyframe_problem import Keyframe, KeyframeProblem, Solution
from dvrk_cmaes.track.reading_buffer import ReadingAt, ReadingBuffer
from dvrk_cmaes.track.view_segmenter import Seen

MOST_KEYFRAMES: Final = 60
LEAST_KEYFRAMES: Final = 12
"""Usable frames from which on a recording is solved by keyframes."""

_LEAST_AREA = 0.5  # of the median area of the masks, from which on a frame is well in view
_MOST_BORDER = 0.3  # share of a mask's contour that may lie on the image's border
# m and rad, of as different poses as
_OF_ENDOSCOPE: Final = {"ecm_insertion": 0.01, "ecm_roll": 0.1, "ecm_yaw": 0.05, "ecm_pitch": 0.05}
_UNITS: Final = {"insertion": 0.01, "roll": 0.5, "yaw": 0.05, "pitch": 0.05, **_OF_ENDOSCOPE}
_JOINT_UNIT = 0.4  # rad, of the instrument's own joints
_TIME_UNITS = 8.0  # of the whole recording


@dataclass(frozen=True)
class MaskShape:
    """Area of a mask, px, the share of its contour that lies on the image's border, and its centre, px."""

    area: float
    on_border: float
    centre: tuple[float, float]

    @classmethod
    def of(cls, mask: Bool) -> MaskShape:
        """Measure a mask (H, W)."""
        if not mask.any():
            return NOTHING
        left, top, width, height = window_around(mask, 1)
        pixels = np.ascontiguousarray(mask[top : top + height, left : left + width]).view(np.uint8)
        moments = cv2.moments(pixels, binaryImage=True)
        area = moments["m00"]
        border = sum(int(np.count_nonzero(side)) for side in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
        inner = cv2.erode(pixels, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
        inside = area - int(np.count_nonzero(inner))
        return cls(area, border / max(border + inside, 1), (left + moments["m10"] / area, top + moments["m01"] / area))


NOTHING: Final = MaskShape(0.0, 1.0, (np.nan, np.nan))
"""The shape of an empty mask."""


def well_in_view(shapes: Sequence[MaskShape]) -> Bool:
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


SOLVED_AT: Final = (4, 8, 12, 16, 20, 24, 36, 48, MOST_KEYFRAMES)
"""Numbers of keyframes at which they are solved together."""

NEW_AT_MOST: Final = 20
"""Of the largest number of keyframes, those that are new since they were last solved, at which they are solved anew."""
RELIABLE: Final = 32
"""Keyframes, from which on the errors of their solution count as shared."""
_NEW_THAT_DISAGREE = 5  # keyframes, of the largest number, with which they are solved anew if images disagree

_LEAST_APART = 0.15  # of `distance_units`, between two keyframes
_LEAST_SECONDS = 0.09  # between two keyframes
_SECONDS = 4.0  # of as different images as one of `distance_units`
_SHAPES = 200  # masks whose areas determine what is well in view


class Keyframes:
    """Keyframes of what is followed, and their last solution; ``readings`` keep those around them.

    ``solved`` is the last solution. ``base`` counts the bases that were given up.
    """

    def __init__(self, given: Followed, readings: ReadingBuffer) -> None:
        self._given, self._readings = given, readings
        self._names = (*OUTER_JOINTS, *given.instrument.joint_names, *ECM_JOINTS)
        self.solved = Solution(None, "", 0, {})
        self.base = 0
        self._alone: dict[str, Result] = {}  # results of keyframes by themselves, by name
        self._kept: list[Keyframe] = []
        self._places = np.zeros((0, len(self._names) + 1))
        self._taken, self._solved_of = 0, 0  # images that were kept so far, and when some were last given to be solved
        self._asked: frozenset[str] = frozenset()  # names of these
        self._shapes: list[MaskShape] = []
        self._last: float | None = None
        self._interval: list[float] = []

    def __len__(self) -> int:
        return len(self._kept)

    def give_up(self, *, few: bool) -> None:
        """Forget the last solution, since images contradict it.

        The base may have moved: the keyframes are forgotten. Those of a solution of ``few`` that are to be solved once
        more are not, since that may have been wrong itself, nor those of an endoscope whose readings say where it is.
        """
        again = few and len(self) > self.solved.keyframes
        self.solved, self._asked = Solution(None, "", 0, {}), frozenset()
        if again or Steered.of(ecm_readings([one.readings for one in self._kept])) is not None:
            return
        self.base += 1
        self._alone.clear()
        self._kept, self._places, self._readings.near = [], self._places[:0], []

    def shows_well(self, masks: Mapping[str, Bool]) -> bool:
        """Return whether an image's masks, by view, show enough of the instrument, by those that were offered."""
        mask = self._first_of(masks)
        return mask is not None and bool(well_in_view([*self._shapes, MaskShape.of(mask)])[-1])

    def _first_of(self, masks: Mapping[str, Bool]) -> Bool | None:
        """Return the mask (H, W) of the first view that has one."""
        mask = next((masks[name] for name in self._given.rig.names if name in masks), None)
        return mask if mask is not None and mask.any() else None

    def offer(self, time: float, reading: ReadingAt, seen: Seen, following: Follower | None) -> None:
        """Keep an image of a time, s, whose readings then are ``reading``, if it shows enough and differs from others.

        Where it has no masks, those are kept that were found about the pose to which it was followed, if that explains
        them. Where readings stand still or are too sparse for the motion, they do not predict what the image shows.
        """
        if reading.still or (reading.sparse is not None and readings_too_sparse(reading.sparse) is not None):
            return
        masks: Mapping[str, Bool] = seen.masks
        if not masks and following is not None and following.explained:
            masks = following.masks
        if not masks:
            return
        if self._last is not None:
            self._interval = [*self._interval[-50:], time - self._last]
        self._last = time
        mask = self._first_of(masks)
        if mask is None:
            return
        self._shapes = [*self._shapes[-_SHAPES:], MaskShape.of(mask)]
        readings = reading.by_name(self._given.instrument.joint_names)
        if not well_in_view(self._shapes)[-1] or not reading.has_outer:
            return
        here = np.array([readings.get(name, 0.0) for name in self._names])
        place = np.array([*(here / distance_units(self._names)), time / _SECONDS])
        apart = float(np.linalg.norm(self._places - place, axis=1).min(initial=np.inf))
        if apart < _LEAST_APART or (self._kept and time - self._kept[-1].time < _LEAST_SECONDS):
            return
        if len(self) >= MOST_KEYFRAMES and not self._drops_one(apart):
            return
        rates = dict(zip(self._names, [*reading.outer_rate.tolist(), *reading.joint_rate.tolist()], strict=False))
        shown, hidden = ({name: np.packbits(each) for name, each in own.items()} for own in (masks, seen.ignored))
        self._kept.append(Keyframe(time, shown, hidden, readings, rates))
        self._places = np.vstack([self._places, place])
        self._readings.near = [keyframe.time for keyframe in self._kept]
        self._taken += 1

    def _drops_one(self, nearest: float) -> bool:
        """Drop one of the two keyframes that are nearest to each other, if they are nearer than ``nearest``."""
        apart = np.linalg.norm(self._places[:, None] - self._places, axis=2) + np.diag(np.full(len(self), np.inf))
        closest = int(apart.min(axis=1).argmin())
        if apart[closest].min() >= nearest:
            return False
        del self._kept[closest]
        self._places = np.delete(self._places, closest, axis=0)
        return True

    def due(self, *, disagrees: bool) -> bool:
        """Whether there are more keyframes than when they were last solved, by enough that it pays.

        Where the last images disagree with the solution, one more is enough. When there are as many as are kept, a
        third of them must be new, or some where images disagree.
        """
        given, new = self._most_given, self._taken - self._solved_of
        if disagrees and given <= self.solved.keyframes and len(self) > SOLVED_AT[0]:
            return new >= (_NEW_THAT_DISAGREE if len(self) >= SOLVED_AT[-1] else 1)
        if given >= SOLVED_AT[-1] and new >= NEW_AT_MOST:
            return True
        return any(given < count <= self._most for count in SOLVED_AT)

    @property
    def _most_given(self) -> int:
        """Most keyframes that were solved, or given to be."""
        return max(self.solved.keyframes, len(self._asked))

    @property
    def _most(self) -> int:
        """Most keyframes to solve next: twice those before, since more would take too long to be used soon."""
        return min(len(self), max(SOLVED_AT[0], 2 * self._most_given))

    def problem(self) -> KeyframeProblem:
        """Return what the keyframes pose to be solved; of many new ones, those that are farthest from each other.

        They test the camera file, which takes long, once as many as are kept have been solved without that.
        """
        keyframes, given, config = self._spread(self._most), self._given, self._given.config
        self._asked, self._solved_of = frozenset(one.name for one in keyframes), self._taken
        if self.solved.keyframes < SOLVED_AT[-1]:
            config = replace(config, session=replace(config.session, test_camera=False))
        keyframes = sorted(keyframes, key=lambda one: one.time)
        alone = {one.name: self._alone[one.name] for one in keyframes if one.name in self._alone}
        interval = float(np.median(self._interval)) if self._interval else 1 / 30
        series = self._readings.series({one.name: one.time for one in keyframes}, interval)
        return KeyframeProblem(tuple(keyframes), series, given.rig, given.arm, config, alone, self.base)

    @property
    def unsolved(self) -> list[KeyframeProblem]:
        """The keyframes that no solution has estimated by themselves yet, first those that are solved next."""
        if all(one.name in self._alone for one in self._kept):
            return []
        given, unsolved = self._given, [one for one in self._spread(len(self)) if one.name not in self._alone]
        return [KeyframeProblem((one,), None, given.rig, given.arm, given.config) for one in unsolved]

    def take(self, solution: Solution) -> SessionCalibration | None:
        """Keep a solution; returns its calibration, if that predicts its frames.

        One of keyframes of a base that was given up since, or of fewer than the last, is not kept.
        """
        if solution.base != self.base or solution.keyframes < self.solved.keyframes:
            return None
        known = self._alone | dict(solution.alone)
        self._alone = {one.name: known[one.name] for one in self._kept if one.name in known}
        self.solved = solution
        return None if solution.reason else solution.calibration

    def _spread(self, most: int) -> list[Keyframe]:
        """Return at most some keyframes: those solved last, and each time that one which is farthest from them."""
        before = [index for index, keyframe in enumerate(self._kept) if keyframe.name in self._asked]
        return [self._kept[index] for index in farthest_first(self._places, before, most)]
