"""Stretches of a mask's contour that are off together: a shadow beside the shaft, a highlight that was cut out.

Neighbouring points of a contour share their error, but the noise of a segmentation changes its sign every few
correlation lengths. A stretch on which all points are off to the same side, by more than that noise, has another cause.
It says nothing about the pose, so such stretches are left out of its information and do not count against the pose.
"""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN, median
from dvrk_cmaes.geometry import Bool, Float64

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
