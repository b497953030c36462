"""Series of joint readings over time, their interpolation at the times of images, and what is known in gaps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.geometry import Bool, Float64, Indices

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

Times = NDArray[np.int64] | Float64

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
    def of(cls, source: str, joints: tuple[str, ...], times: ArrayLike, values: ArrayLike) -> TimedReadings:
        """Create a time series from readings in any order, ns; of several at the same time, the last is used."""
        stamps = np.asarray(times, dtype=np.int64)
        table = np.asarray(values, dtype=np.float64).reshape(len(stamps), len(joints))
        if (np.diff(stamps) > 0).all():
            return cls(joints, stamps, table, source)
        # np.unique returns the first of equal times; the order is reversed to get the last
        increasing, last = np.unique(stamps[::-1], return_index=True)
        return cls(joints, increasing, table[::-1][last], source)

    @cached_property
    def spline(self) -> BSpline:
        """Cubic spline of the number of a reading, with times and readings (1 + J) as its control points."""
        from scipy.interpolate import BSpline  # imported late: most imports do without

        rows = np.column_stack([self.times, self.values])
        control = np.concatenate([2 * rows[:1] - rows[1:2], rows, 2 * rows[-1:] - rows[-2:-1]])
        return BSpline(np.arange(-3.0, len(rows) + 3), control, 3)

    def at(self, times: Times, curve: Curve, rate: Float64 | None = None, **gaps: float) -> Float64:
        """Interpolate the readings at times (L,), (L, J), NaN where they are not `known` by some ``gaps``.

        Beyond the ends, where they are known, the reading at the end is held, or changes by ``rate`` (J,) per unit of
        time; a joint whose rate is NaN is not known at any time.
        """
        if not len(self.times):
            return np.full((len(times), len(self.joints)), np.nan)
        found = curve(self, times)
        if rate is not None:
            beyond = np.minimum(times - self.times[0], 0) + np.maximum(times - self.times[-1], 0)
            found += beyond[:, None] * rate
        found[~self.known(times, **gaps)] = np.nan
        return found

    def known(self, times: Times, *, away: float = np.inf, apart: float = np.inf, beyond: float = 0.0) -> Bool:
        """Whether readings are known at times (L,), (L,); a known row may still have NaN.

        They are known between two that are at most ``apart``, both at most ``away``, up to ``beyond`` before the first
        and after the last, and at the times of readings.
        """
        if not len(self.times):
            return np.zeros(len(times), np.bool_)
        before, after = self.around(times)
        earlier, later = self.times[before], self.times[after]
        outside = np.maximum(earlier - times, times - later)
        inside = (outside <= 0) & (np.maximum(times - earlier, later - times) <= away) & (later - earlier <= apart)
        return np.asarray(inside | (times == earlier) | (times == later) | ((outside > 0) & (outside <= beyond)))

    @cached_property
    def spacing(self) -> float:
        """Median time between readings, of three or more; NaN of fewer."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 2 else np.nan

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
    place = np.interp(times, series.times, np.arange(float(len(series.times))))
    (stamps, *values), (pace, *slopes) = (series.spline(place, order).T for order in (0, 1))
    # of unevenly spaced readings, the spline is there at a slightly other time
    return np.stack(
        [value + (times - stamps) * slope / pace for value, slope in zip(values, slopes, strict=True)], axis=1
    )


_LEAST_SPACING: Final = 0.03  # s, from which on readings may be too sparse; errors of single ones would count otherwise
_LEVER: Final = 0.01  # m, of the jaws about the shaft's axis
MOST_OFF: Final = 4e-3  # m, by which readings may be off without doubt: what they are off widens the predictions
_INSERTION, _ROLL = 2, 3  # places among the outer joints
_LARGEST_ERROR: Final = 1.0  # rad or m: readings of almost the same time give any number, whose square spoils digits
LEAST_ERROR: Final = 2e-4
"""Error of an interpolated reading, rad or m, from which on it is added to the errors of readings themselves."""


@dataclass(frozen=True, eq=False)
class Sparseness:
    """How far the outer joints (4,), rad and m, and the jaws, m, may be off at a time; the spacing, in words.

    By default nothing is known of the readings.
    """

    error: Float64 = field(default_factory=partial(np.zeros, 4))
    off: float = 0.0
    between: str = ""

    @classmethod
    def of(cls, stamps: Float64, values: Float64, time: float) -> Sparseness:
        """Compute how far a straight line between the readings before and after a time, s, may be off.

        It follows from how much the rates change there. Beyond the last reading, the rate before it is gone on with.

        Parameters
        ----------
        stamps : (N,)
            Times of the readings, s, increasing.
        values : (N, 4)
            Readings of the outer joints: yaw, pitch, insertion, roll; rad and m.
        time
            The time, s.
        """
        after = int(np.clip(np.searchsorted(stamps, time), 1, max(len(stamps) - 1, 1)))
        first, last = max(after - 2, 0), min(after + 2, len(stamps))
        if last - first < 3:
            return cls()
        spacing = float(stamps[after] - stamps[after - 1])
        if spacing < _LEAST_SPACING:
            return cls()
        steps, seconds = np.diff(values[first:last], axis=0), np.diff(stamps[first:last])
        rates = steps / seconds[:, None]
        between = (seconds[1:] + seconds[:-1])[:, None] / 2
        bent = np.abs(np.diff(rates, axis=0) / between).max(axis=0)
        inside, beyond = (time - stamps[after - 1]) * (stamps[after] - time), max(time - stamps[after], 0.0)
        error = np.minimum(bent * (max(inside, 0.0) / 2 + beyond * (beyond + 3 * spacing) / 2), _LARGEST_ERROR)
        depth = abs(float(values[after, _INSERTION]))
        off = float(np.hypot(*error[:2])) * depth + float(error[_INSERTION]) + _LEVER * float(error[_ROLL])
        change = np.abs(steps).max(axis=0)
        turn = float(np.delete(change, _INSERTION).max())
        moves = f"the arm turns {np.degrees(turn):.0f} deg"
        if error[_INSERTION] > off / 2:
            moves = f"the insertion changes by {1e3 * change[_INSERTION]:.0f} mm"
        return cls(error, off, f"every {1e3 * spacing:.0f} ms, {moves} between them")
