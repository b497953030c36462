"""Interpolation of joint readings at the times of images: linear, with rules for gaps between readings.

Nothing is extrapolated. Which gaps are too long is told by a `Gaps`; at its own time, a reading is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Times = NDArray[np.float64] | NDArray[np.int64]

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second. Times are integers, because a float of seconds since 1970 has a resolution of 200 ns."""

_FEW = 3  # readings, below which their usual spacing is not known


@dataclass(frozen=True)
class Gaps:
    """Where readings are not interpolated, in the unit of their times; everywhere between two of them by default.

    longest : time between the two readings. farthest : time from either of them. A time at which there is a reading is
    in no gap.
    """

    longest: float = np.inf
    farthest: float = np.inf

    @staticmethod
    def within(tolerance: float) -> Gaps:
        """Both readings must be within a tolerance."""
        return Gaps(farthest=tolerance)

    @staticmethod
    def of_length(longest: float) -> Gaps:
        """Return a rule for readings that may be at most so far apart."""
        return Gaps(longest=longest)

    @staticmethod
    def beyond_usual(times: Times, spacings: float, least: float) -> Gaps:
        """Return a rule for readings at times (M,) that may be some times their median spacing apart, or ``least``."""
        return Gaps() if len(times) < _FEW else Gaps(longest=max(spacings * float(np.median(np.diff(times))), least))


def interpolated(stamps: Times, values: Float64, times: Times, gaps: Gaps) -> Float64:
    """Interpolate readings (M, ...) that were taken at increasing ``stamps`` (M,) at times (T,).

    Returns (T, ...), NaN before the first reading, after the last and in gaps. Integer times are subtracted as such.
    """
    if not len(stamps):
        return np.full((len(times), *values.shape[1:]), np.nan)
    after = np.minimum(np.searchsorted(stamps, times), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    exact = stamps[after] == times
    between = (stamps[0] < times) & (times < stamps[-1])
    apart, since = stamps[after] - stamps[before], times - stamps[before]
    between &= (apart <= gaps.longest) & (np.maximum(since, stamps[after] - times) <= gaps.farthest)
    shape = (-1, *[1] * (values.ndim - 1))
    rate = (values[after] - values[before]) / np.where(apart > 0, apart, 1).reshape(shape)
    along = rate * since.reshape(shape) + values[before]
    known = np.where(between.reshape(shape), along, np.nan)
    return np.asarray(np.where(exact.reshape(shape), values[after], known))


@dataclass(frozen=True, eq=False)
class TimedReadings:
    """Time series of the readings of some joints.

    Parameters
    ----------
    source
        Topic or file of the readings.
    joints
        Names of the J joints.
    times : (N,) int64
        Times of the readings, ns, strictly increasing.
    values : (N, J) float64
        Readings, rad, or m for ``insertion``; NaN where there is none.
    """

    source: str
    joints: tuple[str, ...]
    times: NDArray[np.int64]
    values: NDArray[np.float64]

    @classmethod
    def of(
        cls, source: str, joints: tuple[str, ...], times: Sequence[int], values: Sequence[Sequence[float]]
    ) -> TimedReadings:
        """Create a time series from readings in any order; of several at the same time, the last is used."""
        stamps = np.asarray(times, dtype=np.int64)
        table = np.asarray(values, dtype=np.float64).reshape(len(stamps), len(joints))
        # np.unique returns the first of equal times; the order is reversed to get the last
        increasing, last = np.unique(stamps[::-1], return_index=True)
        return cls(source, joints, increasing, table[::-1][last])

    def at(self, time: int, tolerance: int) -> tuple[NDArray[np.float64], int] | None:
        """Interpolate linearly between the readings before and after a time, both within a tolerance, ns.

        Returns
        -------
        (J,) values and the distance in ns of the farther reading used, or None
            None before the first reading, after the last, and where a reading is farther away than the tolerance.
        """
        after = int(np.searchsorted(self.times, time))
        if after == len(self.times) or (after == 0 and self.times[0] != time):
            return None
        exact = bool(self.times[after] == time)
        near = self.times[after : after + 1] if exact else self.times[after - 1 : after + 1]
        distance = int(np.abs(near - time).max())
        if not exact and distance > tolerance:
            return None
        gaps = Gaps.within(tolerance)
        return interpolated(self.times, self.values, np.array([time], dtype=np.int64), gaps)[0], distance

    def distance(self, time: int) -> int:
        """Return the distance in ns from a time to the nearest reading."""
        after = int(np.searchsorted(self.times, time))
        nearest = self.times[max(after - 1, 0) : after + 1]
        return int(np.abs(nearest - time).min())
