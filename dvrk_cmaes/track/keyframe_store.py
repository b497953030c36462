"""The keyframes that a tracker keeps while it follows.

A keyframe is an image well in view, far enough from all others in the arm's pose and in time. When there are too many,
one of the two that are nearest to each other is dropped, so that they stay spread over all that was seen.
"""

from __future__ import annotations

import zlib
from base64 import b64decode, b64encode
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.track.keyframe_problem import Keyframe, KeyframeProblem, KeyframeTask, packed
from dvrk_cmaes.track.keyframes import MOST_KEYFRAMES, MaskShape, distance_units, well_in_view
from dvrk_cmaes.track.reading_buffer import ReadingRows

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]

SOLVED_AT: Final = (4, 8, 12, 16, 20, 24, 36, 48, MOST_KEYFRAMES)
"""Numbers of keyframes at which they are solved together."""

NEW_AT_MOST: Final = 20
"""Of the largest number of keyframes, those that are new since they were last solved, at which they are solved anew."""

_LEAST_APART = 0.15  # of `distance_units`, between two keyframes
_LEAST_SECONDS = 0.09  # between two keyframes
_SECONDS = 4.0  # of as different images as one of `distance_units`
_AROUND = 0.6  # s, of readings that are kept before and after a keyframe
_LATEST = 2.0  # s, of readings that are kept without a keyframe
_SHAPES = 200  # masks whose areas tell what is well in view
_PRUNED_EVERY = 2000  # readings


class KeyframeStore:
    """Keyframes of what is followed, and the readings around them.

    ``taken`` is the number of images that were kept so far, whether they still are or not.
    """

    def __init__(self, rig: Rig, joint_names: tuple[str, ...]) -> None:
        self._rig = rig
        self._names = (*OUTER_JOINTS, *joint_names)
        self.taken = 0
        self._kept: list[Keyframe] = []
        self._places = np.zeros((0, len(self._names) + 1))
        self._shapes: list[MaskShape] = []
        self._joint_names = joint_names
        self._rows = ReadingRows(joint_names)
        self._added = 0
        self._known_until = -np.inf  # s, of the readings that were there when the store was restored
        self._last: float | None = None
        self._interval: list[float] = []

    def __len__(self) -> int:
        return len(self._kept)

    def clear(self) -> None:
        """Forget all keyframes: those that follow are of another base."""
        self._kept, self._places = [], self._places[:0]

    def add_readings(self, time: float, joints: Mapping[str, float]) -> None:
        """Keep the readings of one time, s; after `restore`, those that were known then may be given again."""
        if time <= self._known_until:
            return
        self._rows.add(time, joints)
        self._added += 1
        if self._added % _PRUNED_EVERY == 0:
            self._prune()

    def shows_well(self, masks: Mapping[str, Bool]) -> bool:
        """Return whether an image's masks, by view, show enough of the instrument, by those that were offered."""
        mask = self._first_of(masks)
        return mask is not None and bool(well_in_view([*self._shapes, MaskShape.of(mask)])[-1])

    def _first_of(self, masks: Mapping[str, Bool]) -> Bool | None:
        """Return the mask (H, W) of the first view that has one."""
        mask = next((masks[name] for name in self._rig.names if name in masks), None)
        return mask if mask is not None and mask.any() else None

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
        if mask is None or not set(OUTER_JOINTS) <= set(readings):
            return False
        self._shapes = [*self._shapes[-_SHAPES:], MaskShape.of(mask)]
        if not well_in_view(self._shapes)[-1] or (self._kept and time - self._kept[-1].time < _LEAST_SECONDS):
            return False
        units = distance_units(self._names)
        values = np.array([readings.get(name, 0.0) for name in self._names])
        place = np.array([*(values / units), time / _SECONDS])
        nearest = float(np.linalg.norm(self._places - place, axis=1).min(initial=np.inf))
        if nearest < _LEAST_APART:
            return False
        if len(self._kept) >= MOST_KEYFRAMES and not self._drops_one(nearest):
            return False
        self._kept.append(Keyframe(time, packed(masks), packed(ignored), dict(readings), dict(rates)))
        self._places = np.vstack([self._places, place])
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

    def unsolved(self, config: EstimateConfig, alone: Mapping[str, Result]) -> list[KeyframeTask]:
        """Return the keyframes without a result of their own among ``alone``, by name, as tasks."""
        return [KeyframeTask(one, self._rig, config) for one in self._kept if one.name not in alone]

    def problem(self, arm: Arm, config: EstimateConfig, alone: Mapping[str, Result], base: int = 0) -> KeyframeProblem:
        """Return what the keyframes pose to be solved; ``alone`` are results of keyframes, by name, if known."""
        rows = self._rows.series
        read = {name: ~np.isnan(values) for name, values in zip(rows.joints, rows.values.T, strict=True)}
        known = {name: at for name, at in read.items() if at.any()}
        series = ReadingSeries(
            "s",
            {name: rows.times[at] for name, at in known.items()},
            {name: rows.values[at, rows.joints.index(name)] for name, at in known.items()},
            {keyframe.name: keyframe.time for keyframe in self._kept},
            float(np.median(self._interval)) if self._interval else 1 / 30,
        )
        known_alone = {name: alone[name] for name in self.names if name in alone}
        return KeyframeProblem(tuple(self._kept), series, self._rig, arm, config, known_alone, base)

    def checkpoint(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return {
            "keyframes": [
                [one.time, _written(one.masks), _written(one.ignored), dict(one.readings), dict(one.rates)]
                for one in self._kept
            ],
            "places": self._places.tolist(),
            "taken": self.taken,
            "shapes": [[shape.area, shape.on_border] for shape in self._shapes],
            "rows": [[time, joints] for time, joints in self._rows.rows],
            "last": self._last,
            "interval": self._interval,
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from the values of `checkpoint`; KeyError, TypeError or ValueError if they are not those."""
        self._kept = [
            Keyframe(float(time), _read(masks), _read(ignored), dict(readings), dict(rates))
            for time, masks, ignored, readings, rates in saved["keyframes"]
        ]
        self._places = np.array(saved["places"], dtype=np.float64).reshape(len(self._kept), len(self._names) + 1)
        self.taken = int(saved["taken"])
        self._shapes = [MaskShape(float(area), float(share)) for area, share in saved["shapes"]]
        self._rows = ReadingRows(self._joint_names)
        for time, joints in saved["rows"]:
            self._rows.add(time, joints)
        self._known_until = max(self._rows.series.times, default=-np.inf)
        self._last = None if saved["last"] is None else float(saved["last"])
        self._interval = [float(value) for value in saved["interval"]]

    def _prune(self) -> None:
        """Drop old readings that are near no keyframe."""
        times = self._rows.series.times
        kept = times > times[-1] - _LATEST
        for keyframe in self._kept:
            kept |= np.abs(times - keyframe.time) < _AROUND
        self._rows.keep(kept)


def _written(masks: Mapping[str, NDArray[np.uint8]]) -> dict[str, str]:
    """Return packed bits by view as text."""
    return {name: b64encode(zlib.compress(bits.tobytes())).decode("ascii") for name, bits in masks.items()}


def _read(masks: Mapping[str, str]) -> dict[str, NDArray[np.uint8]]:
    """Return packed bits by view of their text."""
    return {name: np.frombuffer(zlib.decompress(b64decode(text)), np.uint8) for name, text in masks.items()}
