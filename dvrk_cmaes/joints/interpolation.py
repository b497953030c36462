"""Series of joint readings over time, and their interpolation at the times of images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.geometry import Bool, Float64, Indices
from dvrk_cmaes.joints.gaps import Gaps, Times

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second. Times are integers, because a float of seconds since 1970 has a resolution of 200 ns."""


@dataclass(frozen=True, eq=False)
class TimedReadings:
    """Time series of the readings of some joints.

    Parameters
    ----------
    joints
        Names of the J joints.
    times : (N,) int64 or float64
        Times of the readings, strictly increasing: ns as integers, or s or frames as floats.
    values : (N, J) float64
        Readings, rad, or m for ``insertion``; NaN where there is none.
    source
        Topic or file of the readings.
    """

    joints: tuple[str, ...]
    times: Times
    values: Float64
    source: str = ""

    @classmethod
    def of(
        cls, source: str, joints: tuple[str, ...], times: Sequence[int], values: Sequence[Sequence[float]]
    ) -> TimedReadings:
        """Create a time series from readings in any order, ns; of several at the same time, the last is used."""
        stamps = np.asarray(times, dtype=np.int64)
        table = np.asarray(values, dtype=np.float64).reshape(len(stamps), len(joints))
        # np.unique returns the first of equal times; the order is reversed to get the last
        increasing, last = np.unique(stamps[::-1], return_index=True)
        return cls(joints, increasing, table[::-1][last], source)

    def at(self, times: Times, gaps: Gaps, curve: Curve, rate: Float64 | None = None) -> Float64:
        """Interpolate the readings at times (L,), (L, J), NaN where they are not `known`.

        Where ``gaps`` allow times beyond the ends, the reading at the end is held, or changes by ``rate`` (J,) per
        unit of time; a joint whose rate is NaN is not known at any time.
        """
        if not len(self.times):
            return np.full((len(times), len(self.joints)), np.nan)
        found = curve(self, times)
        if rate is not None:
            beyond = np.minimum(times - self.times[0], 0) + np.maximum(times - self.times[-1], 0)
            found += beyond[:, None] * rate
        found[~self.known(times, gaps)] = np.nan
        return found

    def known(self, times: Times, gaps: Gaps) -> Bool:
        """Whether readings are known at times (L,) by a rule for gaps, (L,); a known row may still have NaN."""
        if not len(self.times):
            return np.zeros(len(times), np.bool_)
        before, after = self.around(times)
        return gaps(times, self.times[before], self.times[after])

    def around(self, times: Times) -> tuple[Indices, Indices]:
        """Find the readings before (or at) and at (or after) times (L,): two indices (L,).

        Beyond the ends these are the two readings at that end; of a single reading, both are that one.
        """
        last = len(self.times) - 1
        after = np.minimum(np.maximum(self.times.searchsorted(times), min(1, last)), last)
        return np.maximum(after - 1, 0), after

    def distances(self, times: Times) -> tuple[Times, Times]:
        """Return the distances (L,) from times (L,) to the nearest reading, and to the farther of the two around.

        Both are zero where there is a reading of the time itself.
        """
        before, after = self.around(times)
        behind, ahead = np.abs(times - self.times[before]), np.abs(self.times[after] - times)
        nearest = np.minimum(behind, ahead)
        return nearest, np.where(nearest == 0, nearest, np.maximum(behind, ahead))


Curve = Callable[[TimedReadings, Times], Float64]
"""A function that evaluates a series of at least one reading at times (L,), (L, J), without regard to gaps."""


def weighted_mean(series: TimedReadings, times: Times) -> Float64:
    """Return the means of the readings before and after times (L,), weighted by nearness, (L, J).

    These are straight lines; with times in ns, the weights are exact. Beyond the ends, the reading there is held.
    """
    before, after = series.around(times)
    earlier, later = series.times[before], series.times[after]
    share = ((times - earlier) / np.where(earlier < later, later - earlier, 1))[:, None]
    mean = (1 - share) * series.values[before] + share * series.values[after]
    mean = np.where((times <= earlier)[:, None], series.values[before], mean)
    return np.where((times >= later)[:, None], series.values[after], mean)


def straight_line(series: TimedReadings, times: Times) -> Float64:
    """Return the readings on straight lines by `numpy.interp`, (L, J); times (L,) are floats.

    For many times this is faster than `weighted_mean`, from which it differs in the last digit. Beyond the ends, the
    reading there is held.
    """
    return np.stack([np.interp(times, series.times, column) for column in series.values.T], axis=1)


def smooth_spline(series: TimedReadings, times: Times) -> Float64:
    """Return the readings by the cubic spline that has them as its control points, (L, J); times (L,) are floats.

    A straight line averages the noise of two readings in its middle, and not at its ends. The spline averages nearly
    the same noise everywhere.
    """
    if len(series.times) < 2:
        return straight_line(series, times)
    return np.stack([_spline(series.times, column, times) for column in series.values.T], axis=1)


def _spline(stamps: Times, values: Float64, times: Times) -> Float64:
    """Evaluate the cubic spline with readings (M,) at times (M,) as control points at times (N,) between them."""
    rows = np.stack([stamps, values], axis=1)
    control = np.concatenate([2 * rows[:1] - rows[1:2], rows, 2 * rows[-1:] - rows[-2:-1]])
    at = np.interp(times, stamps, np.arange(float(len(stamps))))
    first = np.clip(np.floor(at).astype(int), 0, len(stamps) - 2)
    of_value, of_slope = _uniform_basis(at - first)
    near = control[first[:, None] + np.arange(4)]
    place, slope = (np.einsum("kn,nkc->cn", basis, near) for basis in (of_value, of_slope))
    # of unevenly spaced readings, the spline is there at a slightly other time
    return np.asarray(place[1] + (times - place[0]) * slope[1] / slope[0])


def _uniform_basis(t: Float64) -> tuple[Float64, Float64]:
    """Return the four uniform cubic B-splines at shares (N,) of the interval that all cover, and their slopes, (4, N).

    SciPy has them as well, but its import slows the start of a process.
    """
    s = 1 - t
    values = np.stack([s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3]) / 6
    slopes = np.stack([-(s**2), 3 * t**2 - 4 * t, 4 * s - 3 * s**2, t**2]) / 2
    return values, slopes
