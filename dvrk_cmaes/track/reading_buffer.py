"""The latest joint readings, interpolated at the times of images less their lag, and readings that are frozen."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress, pairwise
from typing import Final

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evidence.quantiles import median
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.arguments import check_type, checked_number
from dvrk_cmaes.joints.interpolation import Sparseness, TimedReadings, Times, weighted_mean
from dvrk_cmaes.joints.names import ECM_JOINTS, READINGS, check_readings
from dvrk_cmaes.joints.series import ReadingSeries

_KEPT = 3.0  # s; older readings are dropped
_AROUND = 0.6  # s, before and after a keyframe, within which readings are kept
_RATE_HALF_WIDTH = 0.2  # s, of the readings from which rates are computed
_RATE_SPACINGS, _GAP_SPACINGS, _STILL_SPACINGS = 3.0, 2.0, 4.0  # usual spacings, from which on these count instead
_LATEST = 20  # readings whose spacing is the usual one
_BLOCK = 256  # readings, after which old ones are dropped
_LEAST_FRAMES: Final = 5  # without any change of a reading, from which on it stands still
_LEAST_SHIFT: Final = 0.04  # of the image's width, by which a mask's centre moves where the instrument moves
_SAME = 1e-9  # rad and m


@dataclass(frozen=True, eq=False)
class ReadingAt:
    """Readings at one time: ``outer`` (4,), rad and m, and ``joints`` (J,), rad, with their rates per second.

    Values are NaN where there is no reading. ``still`` is whether the outer joints' readings around that time are
    equal to the last digit. ``sparse`` is how far the interpolated outer joints may be off; None where that is not
    known. ``ecm`` (4,) are the readings of the endoscope's arm, rad and m, None where that is not read.
    """

    outer: Float64
    joints: Float64
    outer_rate: Float64
    joint_rate: Float64
    still: bool = False
    sparse: Sparseness | None = None
    ecm: Float64 | None = None

    @property
    def has_outer(self) -> bool:
        """Whether all outer joints have a reading."""
        return not np.isnan(self.outer).any()

    def by_name(self, joint_names: Sequence[str]) -> dict[str, float]:
        """Return the readings that are there by name; ``joint_names`` are those of the instrument."""
        names = (*OUTER_JOINTS, *joint_names, *ECM_JOINTS)
        values = np.concatenate([self.outer, self.joints, [] if self.ecm is None else self.ecm]).tolist()
        return {name: value for name, value in zip(names, values, strict=False) if not math.isnan(value)}

    @property
    def rates(self) -> Float64:
        """Rates of the outer and the instrument's joints (4 + J,), per s; 0 where unknown."""
        return np.asarray(np.nan_to_num(np.concatenate([self.outer_rate, self.joint_rate])))


class ReadingBuffer:
    """The readings of the last seconds, and those around some times, s, ``near``; they may arrive at any rate.

    They may come before or after the images they belong to.

    Joints may be read at times of their own, as the jaw is on its own topic: each is interpolated between its own
    readings.

    Parameters
    ----------
    joint_names
        Names of the instrument's J joints.
    gap
        Longest time, s, over which readings are interpolated or gone on with; of readings that are usually farther
        apart than half of it, twice their usual spacing.
    still
        Time, s, after which unchanged readings count as frozen, or four times their usual spacing, if that is longer.
    """

    def __init__(self, joint_names: Sequence[str], gap: float, still: float) -> None:
        self._names = (*OUTER_JOINTS, *joint_names)
        self._gap, self._still = gap, still
        self._read: dict[str, tuple[list[float], list[float]]] = {}  # times, s, and readings by joint
        self._found: dict[float, ReadingAt] = {}  # what `at` returned at the last two times since readings came
        self._added = 0
        self.near: list[float] = []

    def series(self, frames: Mapping[str, float], interval: float) -> ReadingSeries:
        """Return the readings that are kept, with the times of some frames, s, and the time between images, s."""
        times, values = ({name: np.array(own[k]) for name, own in self._read.items()} for k in (0, 1))
        return ReadingSeries("s", times, values, frames, interval)

    def add(self, time: float, joints: Mapping[str, float]) -> None:
        """Add the readings of one time, s; of two of a joint at the same time, the last is used.

        Raises
        ------
        InputError
            The time or a reading is not finite, a reading is in another unit, or a joint is unknown.
        """
        if not math.isfinite(checked_number("readings: time", time, "a finite number of seconds")):
            raise InputError(f"readings: time: expected a finite number of seconds, got {time}")
        check_type("readings", joints, Mapping, READINGS)
        of_ecm = joints.keys() & set(ECM_JOINTS)
        check_readings("readings", {name: joints[name] for name in of_ecm}, ECM_JOINTS)
        if len(of_ecm) < len(joints) or not joints:
            check_readings("readings", {name: joints[name] for name in joints if name not in of_ecm}, self._names)
        for name, value in joints.items():
            times, values = self._read.setdefault(name, ([], []))
            at = bisect_left(times, time)
            if at < len(times) and times[at] == time:
                values[at] = value
            else:
                times.insert(at, time)
                values.insert(at, value)
        self._found.clear()
        self._added += 1
        if self._added % _BLOCK == 0:
            self._drop_old()

    def _drop_old(self) -> None:
        """Drop readings that are neither of the last seconds nor near one of the times."""
        newest = max(times[-1] for times, _ in self._read.values())
        for times, values in self._read.values():
            kept = np.array(times) > newest - _KEPT
            for one in self.near:
                kept |= np.abs(np.array(times) - one) < _AROUND
            times[:], values[:] = compress(times, kept), compress(values, kept)

    def at(self, time: float) -> ReadingAt:
        """Interpolate the readings linearly at a time, s; beyond them they are extrapolated by at most the gap."""
        if time not in self._found:
            if len(self._found) > 1:  # an image's time, and that less the lag
                del self._found[next(iter(self._found))]
            self._found[time] = self._interpolated(time)
        return self._found[time]

    def _interpolated(self, time: float) -> ReadingAt:
        outer = len(OUTER_JOINTS)
        row, rate = np.full(len(self._names), np.nan), np.zeros(len(self._names))
        recent = self._recent()
        for series in _read_together(recent):
            columns = [self._names.index(name) for name in series.joints]
            spacing = _usual_spacing(series.times)
            rate[columns] = of_series = _rate(series, time, max(_RATE_HALF_WIDTH, _RATE_SPACINGS * spacing))
            gap = max(self._gap, _GAP_SPACINGS * spacing)
            row[columns] = series.at(np.array([time]), weighted_mean, of_series, apart=gap, beyond=gap)[0]
        still, sparse = False, None
        if recent.keys() >= set(OUTER_JOINTS):
            times = recent[OUTER_JOINTS[0]][0]
            values = np.column_stack([np.interp(times, *recent[name]) for name in OUTER_JOINTS])
            still = _is_still(times, values, time, max(self._still, _STILL_SPACINGS * _usual_spacing(times)))
            sparse = None if np.isnan(row[:outer]).any() else Sparseness.of(times, values, time)
        of_ecm = ECM_JOINTS if self._read.keys() >= set(ECM_JOINTS) else ()
        ecm = np.array([np.interp(time, *self._read[name]) for name in of_ecm]) if of_ecm else None
        return ReadingAt(row[:outer], row[outer:], rate[:outer], rate[outer:], still, sparse, ecm)

    def _recent(self) -> dict[str, tuple[Float64, Float64]]:
        """Return times and readings of the last seconds by joint, of those that have any."""
        read = {name: self._read[name] for name in self._names if name in self._read}
        since = max((times[-1] for times, _ in read.values() if times), default=0.0) - _KEPT
        first = {name: bisect_left(times, since) for name, (times, _) in read.items() if times and times[-1] >= since}
        return {name: (np.array(read[name][0][k:]), np.array(read[name][1][k:])) for name, k in first.items()}


def _read_together(recent: Mapping[str, tuple[Float64, Float64]]) -> Iterator[TimedReadings]:
    """Yield the readings of joints, each with those that are read at the same times."""
    groups: dict[bytes, list[str]] = {}
    for name, (times, _) in recent.items():
        groups.setdefault(times.tobytes(), []).append(name)
    for names in groups.values():
        yield TimedReadings(tuple(names), recent[names[0]][0], np.column_stack([recent[name][1] for name in names]))


def _usual_spacing(stamps: Times) -> float:
    """Return the median time, s, between the latest readings, at times (N,); 0 for fewer than three."""
    return float(median(np.diff(stamps[-_LATEST:]))) if len(stamps) > 2 else 0.0


def _rate(series: TimedReadings, time: float, half_width: float) -> Float64:
    """Return the rates (J,) by a straight line through the readings within a half width, s, of a time; 0 where unknown.

    The readings on either side of the time do not count, so that the errors of the rates are independent of those
    of the interpolated readings; otherwise a lag that is estimated from both would be biased.
    """
    first, after, last = series.times.searchsorted([time - half_width, time, time + half_width])
    index = np.concatenate([np.arange(first, after - 1), np.arange(after + 1, last)])
    if len(index) < 2:
        return np.zeros(len(series.joints))
    at = series.times[index]
    at -= at.mean()
    rate = at @ series.values[index] / (at @ at)
    return np.asarray(np.where(np.isnan(rate), 0.0, rate))


def _is_still(times: Float64, values: Float64, time: float, seconds: float) -> bool:
    """Whether the outer joints' readings up to a time have not changed in the last digit for some seconds."""
    last = min(int(times.searchsorted(time)), len(times) - 1)
    first = int(times.searchsorted(times[last] - seconds))
    if last - first < 3 or times[last] - times[first] < 0.8 * seconds:
        return False
    return bool(np.ptp(values[first : last + 1], axis=0).max() == 0)


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


def frozen_since(frozen: Bool, names: Sequence[str]) -> list[str]:
    """Return for each frame the name of that since which its readings are frozen; empty where they are not."""
    since: list[str] = []
    for i, name in enumerate(names):
        since.append("" if not frozen[i] else since[-1] if i and frozen[i - 1] else name)
    return since
