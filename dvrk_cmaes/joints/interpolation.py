"""Joint readings over time, interpolated to the time of an image, never beyond what was read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NANOSECONDS = 1_000_000_000
"""In a second. Times are whole nanoseconds: a float of seconds since 1970 is no finer than 200 ns."""


@dataclass(frozen=True, eq=False)
class TimedReadings:
    """Readings of some joints over time.

    Parameters
    ----------
    source
        Topic or file that they are from.
    joints
        Names of the J joints.
    times : (N,) int64
        Increasing, ns.
    values : (N, J) float64
        rad, or m for ``insertion``; NaN where a reading is not known.
    """

    source: str
    joints: tuple[str, ...]
    times: NDArray[np.int64]
    values: NDArray[np.float64]

    @classmethod
    def of(
        cls, source: str, joints: tuple[str, ...], times: Sequence[int], values: Sequence[Sequence[float]]
    ) -> TimedReadings:
        """Sort readings by time; of several at one time the last holds."""
        stamps = np.asarray(times, dtype=np.int64)
        table = np.asarray(values, dtype=np.float64).reshape(len(stamps), len(joints))
        # np.unique keeps the first of equal ones, so it is shown them from the end
        increasing, last = np.unique(stamps[::-1], return_index=True)
        return cls(source, joints, increasing, table[::-1][last])

    def at(self, time: int, tolerance: int) -> tuple[NDArray[np.float64], int] | None:
        """Interpolate linearly between the readings on either side of a time, both within a tolerance, ns.

        Returns
        -------
        (J,) values and the distance in ns of the farther reading used, or None
            None before the first reading, after the last, and in a gap.
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
        share = (time - earlier) / (later - earlier)
        return (1 - share) * self.values[after - 1] + share * self.values[after], distance

    def distance(self, time: int) -> int:
        """Distance in ns from a time to the nearest reading."""
        after = int(np.searchsorted(self.times, time))
        near = self.times[max(after - 1, 0) : after + 1]
        return int(np.abs(near - time).min())
