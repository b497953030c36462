"""Colours of the instrument and of its surroundings, learned along the outline of a pose that is trusted."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

_BINS = 20  # of a channel
_SMOOTHING = 0.7  # bins, standard deviation by which a histogram is smoothed
_FLOOR = 0.05  # of the probability, spread evenly over all colours: those that were not seen tell nothing
_LARGEST = 3.0  # log-odds of a single pixel
# bins by the square root of a channel's value: dark colours, such as the shaft's, need finer ones
_BIN_OF = np.minimum((np.sqrt(np.arange(256) / 255.0) * _BINS).astype(np.int32), _BINS - 1)
_BIN_OF_CHANNEL = [_BIN_OF * _BINS**k for k in (2, 1, 0)]


def _smoothing() -> Float32:
    """Return the matrix (B, B) that smooths a histogram along one channel."""
    at = np.arange(_BINS)
    kernel = np.exp(-0.5 * ((at[:, None] - at) / _SMOOTHING) ** 2)
    return np.asarray(kernel / kernel.sum(axis=0), np.float32)


_SMOOTH = _smoothing()


def bins_of(pixels: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Return the index of the histogram's bin of each pixel (..., 3), BGR."""
    blue, green, red = (bins.take(pixels[..., k]) for k, bins in enumerate(_BIN_OF_CHANNEL))
    return np.asarray(blue + green + red)


def _histogram(bins: NDArray[np.int32]) -> Float32:
    """Return the smoothed histogram (B^3,) of pixels' bins, of sum one."""
    count = np.bincount(bins, minlength=_BINS**3).astype(np.float32)
    for _ in range(3):  # each time along the first channel, which then becomes the last
        count = (_SMOOTH @ count.reshape(_BINS, -1)).T
    return np.asarray(count.ravel() / max(float(count.sum()), 1e-9), np.float32)


@dataclass(frozen=True, eq=False)
class ColourModel:
    """Histograms of colours: ``inside`` (P, B^3) of each of P parts of the instrument, ``outside`` (B^3,) beside it.

    ``log_odds`` (P, B^3) is the logarithm of the ratio of their probabilities.
    """

    inside: Float32
    outside: Float32
    log_odds: Float32

    @property
    def bins(self) -> int:
        """Number of bins of a histogram."""
        return int(self.log_odds.shape[1])

    @staticmethod
    def of(inside: Float32, outside: Float32) -> ColourModel:
        """Return the model of histograms."""
        floor = np.float32(_FLOOR / _BINS**3)
        odds = np.log((inside + floor) / (outside + floor))
        return ColourModel(inside, outside, np.clip(odds, -_LARGEST, _LARGEST))

    @staticmethod
    def learned(inside: Sequence[NDArray[np.int32]], outside: NDArray[np.int32]) -> ColourModel:
        """Return the model of the bins of pixels, within each part and outside."""
        return ColourModel.of(np.stack([_histogram(bins) for bins in inside]), _histogram(outside))

    def mixed(self, other: ColourModel, share: float) -> ColourModel:
        """Return the model with a share of another one's histograms."""
        keep = np.float32(1 - share)
        inside = keep * self.inside + np.float32(share) * other.inside
        outside = keep * self.outside + np.float32(share) * other.outside
        return ColourModel.of(inside, outside)

    def checkpoint(self) -> dict[str, str]:
        """Return the histograms as text."""
        sides = {"inside": self.inside, "outside": self.outside}
        return {name: base64.b64encode(zlib.compress(side.tobytes())).decode() for name, side in sides.items()}

    @staticmethod
    def restored(saved: Mapping[str, str]) -> ColourModel:
        """Return the model of the texts of `checkpoint`; KeyError, TypeError or ValueError if they are not those."""
        inside, outside = (_numbers(saved[name]).reshape(-1, _BINS**3) for name in ("inside", "outside"))
        if len(outside) != 1 or not len(inside):
            raise ValueError("expected one histogram of the surroundings")
        return ColourModel.of(inside, outside[0])


def _numbers(text: str) -> Float32:
    """Return the numbers of a text of `ColourModel.checkpoint`."""
    try:
        values = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.float32)
    except zlib.error:
        raise ValueError("expected histograms") from None
    if not (np.isfinite(values) & (values >= 0)).all():
        raise ValueError("expected finite shares")
    return values
