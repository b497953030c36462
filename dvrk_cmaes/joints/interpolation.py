"""Time series of joint readings, with linear interpolation at the time of an image and no extrapolation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second. Times are integers, because a float of seconds since 1970 has a resolution of 200 ns."""


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
        if after == len(self.times):
            return None
        if self.times[after] == time:
            return self.values[after], 0
        if after == 0:
            return None
        earlier, later = int(self.times[after - 1]), int(self.times[after])
        distance = max(time - earlier, later - time)
        if distance > tolerance:
            return None
        fraction = (time - earlier) / (later - earlier)
        return (1 - fraction) * self.values[after - 1] + fraction * self.values[after], distance

    def distance(self, time: int) -> int:
        """Return the distance in ns from a time to the nearest reading."""
        after = int(np.searchsorted(self.times, time))
        nearest = self.times[max(after - 1, 0) : after + 1]
        return int(np.abs(nearest - time).min())
