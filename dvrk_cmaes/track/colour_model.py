"""Colours of the instrument and of its surroundings, learned along the outline of a pose that is trusted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.track.histogram_ratio import HistogramRatio

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
