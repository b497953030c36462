"""The latest joint readings, interpolated at the times of images less their lag."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.interpolation import Gaps, interpolated
from dvrk_cmaes.joints.names import joint_reading

Float64 = NDArray[np.float64]

_KEPT = 3.0  # s; older readings are dropped
_RATE_HALF_WIDTH = 0.2  # s, of the readings from which rates are computed
_MOST = 6000  # readings; at higher rates than 2 kHz a shorter time is kept


@dataclass(frozen=True, eq=False)
class ReadingAt:
    """Readings at one time: ``outer`` (4,), rad and m, and ``joints`` (J,), rad, with their rates per second.

    Values are NaN where there is no reading. ``still`` tells whether the outer joints' readings around that time are
    equal to the last digit.
    """

    outer: Float64
    joints: Float64
    outer_rate: Float64
    joint_rate: Float64
    still: bool = False

    @property
    def has_outer(self) -> bool:
        """Whether all outer joints have a reading."""
        return not np.isnan(self.outer).any()


class ReadingBuffer:
    """The readings of the last seconds; readings may arrive at any rate, before or after the images they belong to.

    Parameters
    ----------
    joint_names
        Names of the instrument's J joints.
    gap
        Longest time, s, over which readings are interpolated or held.
    still
        Time, s, after which unchanged readings count as frozen.
    """

    def __init__(self, joint_names: Sequence[str], gap: float, still: float) -> None:
        self._names = (*OUTER_JOINTS, *joint_names)
        self._gap = gap
        self._still = still
        self._times: list[float] = []
        self._rows: list[Float64] = []

    def add(self, time: float, joints: Mapping[str, float]) -> None:
        """Add the readings of one time, s; of two at the same time, the last is used.

        Raises
        ------
        InputError
            The time or a reading is not finite, a reading is in another unit, or a joint is unknown.
        """
        if not np.isfinite(time):
            raise InputError(f"readings: time: expected a finite number of seconds, got {time}")
        for name, value in joints.items():
            if name not in self._names and name != "jaw":
                near = ", ".join(nearest_first(name, self._names))
                raise InputError(f"readings: unknown joint {name!r}; expected one of: {near}")
            joint_reading("readings", name, float(value))
        row = np.array([joints.get(name, np.nan) for name in self._names], dtype=np.float64)
        at = bisect_left(self._times, time)
        if at < len(self._times) and self._times[at] == time:
            self._rows[at] = row
            return
        self._times.insert(at, float(time))
        self._rows.insert(at, row)
        first = max(bisect_left(self._times, self._times[-1] - _KEPT), len(self._times) - _MOST)
        if first > 256:  # dropped in blocks: removal from the front of a list moves all that follows
            del self._times[:first], self._rows[:first]

    @property
    def last(self) -> float | None:
        """Time of the latest reading, s; None without any."""
        return self._times[-1] if self._times else None

    def at(self, time: float) -> ReadingAt:
        """Interpolate the readings linearly at a time, s; beyond them they are extrapolated by at most the gap."""
        after = bisect_left(self._times, time)
        rate, outer = self._rate(time, after), len(OUTER_JOINTS)
        near = slice(max(after - 1, 0), after + 1)
        stamps, rows = np.array(self._times[near]), np.array(self._rows[near]).reshape(-1, len(self._names))
        row = interpolated(stamps, rows, np.array([time]), Gaps.of_length(self._gap))[0]
        if len(stamps) and not stamps[0] <= time <= stamps[-1] and np.abs(stamps - time).min() <= self._gap:
            nearest = int(np.abs(stamps - time).argmin())
            row = rows[nearest] + rate * (time - stamps[nearest])
        return ReadingAt(row[:outer], row[outer:], rate[:outer], rate[outer:], self._is_still(after))

    def outer_at(self, times: Float64) -> Float64:
        """Interpolate the outer joints' readings at times (L,), (L, 4); NaN where there is none."""
        begin = bisect_left(self._times, float(times.min()) - self._gap)
        end = bisect_left(self._times, float(times.max()) + self._gap)
        at, rows = np.array(self._times[begin:end]), self._rows[begin:end]
        if len(rows) < 2:
            return np.full((len(times), len(OUTER_JOINTS)), np.nan)
        values = np.array(rows)[:, : len(OUTER_JOINTS)]
        slope = (values[-1] - values[-2]) / (at[-1] - at[-2])
        outer = interpolated(at, values, np.minimum(times, at[-1]), Gaps())
        outer += np.maximum(times - at[-1], 0.0)[:, None] * slope
        outer[times > at[-1] + self._gap] = np.nan
        return np.asarray(outer)

    def _rate(self, time: float, after: int) -> Float64:
        """Return the rates around a time by a straight line through the readings near it, (4 + J,); 0 where unknown.

        The readings on either side of the time do not count, so that the errors of the rates are independent of those
        of the interpolated readings; otherwise a lag that is estimated from both would be biased.
        """
        first = bisect_left(self._times, time - _RATE_HALF_WIDTH)
        last = bisect_left(self._times, time + _RATE_HALF_WIDTH)
        index = [k for k in range(first, last) if k not in (after - 1, after)]
        if len(index) < 2:
            return np.zeros(len(self._names))
        at = np.array([self._times[k] for k in index])
        at -= at.mean()
        rate = at @ np.array([self._rows[k] for k in index]) / (at @ at)
        return np.asarray(np.where(np.isnan(rate), 0.0, rate))

    def _is_still(self, index: int) -> bool:
        """Whether the readings up to an index have not changed in the last digit for longer than ``still``."""
        last = min(index, len(self._times) - 1)
        first = bisect_left(self._times, (self._times[last] if self._times else 0.0) - self._still)
        if last - first < 3 or self._times[last] - self._times[first] < 0.8 * self._still:
            return False
        outer = np.array(self._rows[first : last + 1])[:, : len(OUTER_JOINTS)]
        return bool(np.ptp(outer, axis=0).max() == 0) if not np.isnan(outer).any() else False
