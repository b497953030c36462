"""Statistics of distances along a contour: median, quantiles, and stretches that are off together.

Median and quantiles are as NumPy computes them, of numbers that are known to be finite. NumPy's functions take several
times as long for a few hundred numbers, and import numpy.ma, a twentieth of the processor time of a whole command.

Stretches that are off together are of a shadow beside the shaft, or a highlight that was cut out. Neighbouring points
of a contour share their error, but the noise of a segmentation changes its sign every few correlation lengths. A
stretch on which all points are off to the same side, by more than that noise, has another cause. It says nothing about
the pose, so such stretches are left out of its information and do not count against the pose.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Bool, Float64

NORMAL_MEDIAN: Final = 1.4826
"""Standard deviations of a normal distribution for each median of its absolute values."""

Values = NDArray[np.floating] | NDArray[np.integer]


def median(values: Values) -> float:
    """Return the median of finite values (N,), N > 0."""
    middle = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, middle)[middle])
    below, above = np.partition(values, (middle - 1, middle))[middle - 1 : middle + 1]
    return float((below + above) / 2)


def quantile(values: Values, share: float) -> float:
    """Return the value below which a share, 0 to 1, of finite values (N,), N > 0, lies; linear between two of them."""
    place = share * (len(values) - 1)
    index = int(place)
    after = min(index + 1, len(values) - 1)
    ordered = np.partition(values, (index, after))
    low, high, part = float(ordered[index]), float(ordered[after]), place - index
    return high - (high - low) * (1 - part) if part >= 0.5 else low + (high - low) * part


_OFF = 2.5  # standard deviations of the contour's noise, from which on a point is off
_LEAST_OFF = 1.5  # px, the same at least
_LEAST_LENGTH = 6  # points, of a stretch
_LARGEST_GAP = 3.0  # px between neighbouring points of a stretch


def steady_stretches(contour: Float64, distances: Float64) -> Bool:
    """Find the points of a contour that lie on a stretch which is off together, (N,) bool.

    ``contour`` (N, 2) px are a mask's contour points in their order along it, ``distances`` (N,) px their signed
    distances to the outline of a silhouette. The noise is estimated from the median distance.
    """
    if not len(distances):
        return np.zeros(0, dtype=np.bool_)
    noise = NORMAL_MEDIAN * median(np.abs(distances))
    side = np.where(np.abs(distances) > max(_OFF * noise, _LEAST_OFF), np.sign(distances), 0.0)
    apart = np.linalg.norm(np.diff(contour, axis=0), axis=1) > _LARGEST_GAP
    stretch = np.concatenate([[0], np.cumsum((np.diff(side) != 0) | apart)])
    long_enough = np.bincount(stretch)[stretch] >= _LEAST_LENGTH
    return np.asarray((side != 0) & long_enough)
