"""Rules for gaps in series of readings: at which times readings are known by those before and after.

A rule gets times (L,), and for each the times (L,) of the readings before (or at) and at (or after) it, all in one
unit. Of times before the first reading or after the last, these are the two readings at that end; of a series of one
reading, both are that one. A rule returns whether readings are known at the times, (L,).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Bool, Float64

Times = NDArray[np.int64] | Float64
Known = Bool
Gaps = Callable[[Times, Times, Times], Known]

_SPACINGS = 3.0  # in which the usual longest gap is measured


def within(tolerance: float) -> Gaps:
    """Return the rule that both readings are at most ``tolerance`` away, or one is at the time itself."""

    def known(times: Times, earlier: Times, later: Times) -> Known:
        near = np.maximum(times - earlier, later - times) <= tolerance
        return _is_read(times, earlier, later) | (_is_between(times, earlier, later) & near)

    return known


def largest_distance(stamps: Times, tolerance: int) -> int:
    """Return the tolerance, or one and a half times the median spacing of ``stamps`` (N,) where that is more.

    Readings that a robot sends five times a second are thus interpolated as those of a faster one are. Fewer than four
    readings have no usual spacing.
    """
    return tolerance if len(stamps) < 4 else max(tolerance, round(1.5 * float(np.median(np.diff(stamps)))))


def longest(gap: float) -> Gaps:
    """Return the rule that the two readings are at most ``gap`` apart, or one is at the time itself."""

    def known(times: Times, earlier: Times, later: Times) -> Known:
        near = later - earlier <= gap
        return _is_read(times, earlier, later) | (_is_between(times, earlier, later) & near)

    return known


def usual_spacing(stamps: Times, least: float) -> Gaps:
    """Return the rule `longest` of three times the median spacing of ``stamps`` (N,), and not below ``least``.

    Between fewer than three readings there is no gap.
    """
    return longest(np.inf if len(stamps) < 3 else max(_SPACINGS * float(np.median(np.diff(stamps))), least))


def unbroken(gap: float) -> Gaps:
    """Return the rule that the two readings are at most ``gap`` apart, even if one is at the time itself.

    A longer gap thus includes the reading that ends it, and one after the first reading the first as well.
    """

    def known(times: Times, earlier: Times, later: Times) -> Known:
        return _is_between(times, earlier, later) & (later - earlier <= gap)

    return known


def extrapolated(gap: float) -> Gaps:
    """Return the rule `longest`, and that readings are known up to ``gap`` before the first and after the last."""
    inside = longest(gap)

    def known(times: Times, earlier: Times, later: Times) -> Known:
        beyond = np.maximum(earlier - times, times - later)
        return inside(times, earlier, later) | ((beyond > 0) & (beyond <= gap))

    return known


def continued(gap: float) -> Gaps:
    """Return the rule that readings are known from the first one until ``gap`` after the last, however far apart."""

    def known(times: Times, earlier: Times, later: Times) -> Known:
        return (earlier <= times) & (times <= later + gap)

    return known


def _is_between(times: Times, earlier: Times, later: Times) -> Known:
    """Whether times are not beyond the ends of their series."""
    return (earlier <= times) & (times <= later)


def _is_read(times: Times, earlier: Times, later: Times) -> Known:
    """Whether there are readings of the times themselves."""
    return np.asarray((times == earlier) | (times == later))
