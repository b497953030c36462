"""How an image changes across the instrument's outline, and elsewhere, learned along the outline of a trusted pose.

A shadow changes all channels in the same proportion, the outline of an instrument often does not. A change is described
by the ratios of the channels on the outer and on the inner side: their mean, and their largest difference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.track.histogram_ratio import HistogramRatio

Int32 = NDArray[np.int32]

REACH = 2
"""Samples on either side of an edge from which its change is taken: the farther one of them."""

_DARK = 12.0  # value below which noise prevails over the ratio of two values
_STEPS = 12.0  # of the logarithm, for a factor of e
_WIDTH = 12  # such steps, summed over three channels, of a bin of the mean
_HALF = 8  # bins of the mean on either side of the middle one
_DIFFERENCES = (2, 4, 7, 11, 16)  # steps, limits of the bins of the difference between channels
_KINDS = len(_DIFFERENCES) + 1
_LOG = np.rint(_STEPS * np.log1p(np.arange(256) / _DARK)).astype(np.int16)
_BIN_OF_DIFFERENCE = np.searchsorted(_DIFFERENCES, np.arange(2 * int(_LOG[-1]) + 1), side="right").astype(np.int32)


def changes_along(colours: NDArray[np.uint8]) -> Int32:
    """Return the bins (N, K + 1 - 2 `REACH`) of the changes along lines of colours (N, K, 3), BGR, outwards.

    The first one is that between samples ``REACH - 1`` and ``REACH``.
    """
    logs = _LOG.take(colours)
    apart = 2 * REACH - 1
    change = logs[:, apart:] - logs[:, :-apart]
    first, second, third = (change[..., k] for k in range(3))
    mean = np.floor_divide(first.astype(np.int32) + second + third + _WIDTH // 2, _WIDTH)
    difference = np.maximum(np.maximum(first, second), third) - np.minimum(np.minimum(first, second), third)
    return np.asarray((np.clip(mean, -_HALF, _HALF) + _HALF) * np.int32(_KINDS) + _BIN_OF_DIFFERENCE.take(difference))


class EdgeModel(HistogramRatio):
    """Histograms of changes: at the outline of each of P parts of the instrument, and elsewhere."""

    shape = (2 * _HALF + 1, _KINDS)
    smoothing = 0.6
