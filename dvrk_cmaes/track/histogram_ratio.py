"""Probabilities of something seen, on the instrument and elsewhere, as histograms that are learned and forgotten."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import prod
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Float32

_FLOOR = 0.05  # of the probability, spread evenly over all bins: what was not seen tells nothing
_LARGEST = 3.0  # log-odds of a single pixel


@cache
def _smoothing(count: int, std: float) -> Float32:
    """Return the matrix (N, N) that smooths a histogram along one axis, by a standard deviation in bins."""
    at = np.arange(count)
    kernel = np.exp(-0.5 * ((at[:, None] - at) / std) ** 2)
    return np.asarray(kernel / kernel.sum(axis=0), np.float32)


@dataclass(frozen=True, eq=False)
class HistogramRatio:
    """Histograms ``inside`` (P, B), of each of P parts of the instrument, and ``outside`` (B,), of all else.

    ``log_odds`` (P, B) is the logarithm of the ratio of their probabilities. The bins of a subclass have a ``shape``
    with the product B; histograms are smoothed along each axis by ``smoothing`` bins, a standard deviation.
    """

    inside: Float32
    outside: Float32
    log_odds: Float32

    shape: ClassVar[tuple[int, ...]]
    smoothing: ClassVar[float]

    @classmethod
    def of(cls, inside: Float32, outside: Float32) -> Self:
        """Return the model of histograms."""
        floor = np.float32(_FLOOR / outside.size)
        odds = np.log((inside + floor) / (outside + floor))
        return cls(inside, outside, np.clip(odds, -_LARGEST, _LARGEST))

    @classmethod
    def learned(cls, inside: Sequence[NDArray[np.int32]], outside: NDArray[np.int32]) -> Self:
        """Return the model of the bins that were seen, within each part and elsewhere."""
        return cls.of(np.stack([cls._histogram(bins) for bins in inside]), cls._histogram(outside))

    @classmethod
    def _histogram(cls, bins: NDArray[np.int32]) -> Float32:
        """Return the smoothed histogram (B,) of bins, of sum one."""
        count = np.bincount(bins, minlength=prod(cls.shape)).astype(np.float32)
        for size in cls.shape:  # each time along the first axis, which then becomes the last
            count = (_smoothing(size, cls.smoothing) @ count.reshape(size, -1)).T
        return np.asarray(count.ravel() / max(float(count.sum()), 1e-9), np.float32)

    def mixed(self, other: Self, share: float) -> Self:
        """Return the model with a share of another one's histograms."""
        keep, new = np.float32(1 - share), np.float32(share)
        return self.of(keep * self.inside + new * other.inside, keep * self.outside + new * other.outside)


_BINS = 20  # of a channel
# bins by the square root of a channel's value: dark colours, such as the shaft's, need finer ones
_BIN_OF = np.minimum((np.sqrt(np.arange(256) / 255.0) * _BINS).astype(np.int32), _BINS - 1)
_BIN_OF_CHANNEL = [_BIN_OF * _BINS**k for k in (2, 1, 0)]


def bins_of(pixels: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Return the index of the histogram's bin of each pixel (..., 3), BGR."""
    blue, green, red = (bins.take(pixels[..., k]) for k, bins in enumerate(_BIN_OF_CHANNEL))
    return np.asarray(blue + green + red)


class ColourModel(HistogramRatio):
    """Histograms of colours: of each of P parts of the instrument, and beside it."""

    shape = (_BINS,) * 3
    smoothing = 0.7


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
