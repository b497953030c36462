"""Masks of an instrument in a recording's images, found around the silhouettes that its calibration expects.

The colours of instrument and surroundings are those of the recording's keyframes, learned at their fitted poses. What
an image shows is decided by these colours, by the edge between the local colours on both sides of the outline, and by
the silhouette, whose outline may be off by as much as the prediction is uncertain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.geometry import Bool, Float32, Image
from dvrk_cmaes.segment import around
from dvrk_cmaes.segment.prompts import no_prompts
from dvrk_cmaes.segment.regions import FINEST, resized, shrunk, size_within

_BLURRED = 2.0  # px from the outline, within which pixels have colours of both sides
_AROUND = 40.0  # px from the outline, within which colours are learned
_LEAST_PIXELS = 200  # on each side of an outline, from which its colours are learned

_COLOURS_WEIGHT = 0.6  # of the log-odds of a pixel's colour: neighbours are alike
_LEAST_ODDS = 0.2  # log-odds by colour, from which on a pixel has the instrument's colours
_NOWHERE = 0.8  # share of the silhouette without these, from which on it shows nothing of the instrument
_MARGIN = 12  # px about the pixels that may be instrument, whose log-odds by colour are computed
_NOISE = 1.0  # px, standard deviation of the Gaussian that smooths these log-odds
SPREAD_OF_FIT: Final = 2.0
"""Standard deviation, px, of the outline of a pose that is fitted to an image."""
PASSES: Final = 2
"""Passes in which a mask is found, where the silhouette is that of a prediction."""


_BINS = 20  # of a channel
# bins by the square root of a channel's value: dark colours, such as the shaft's, need finer ones
_BIN_OF = np.minimum((np.sqrt(np.arange(256) / 255.0) * _BINS).astype(np.int32), _BINS - 1)
_BIN_OF_CHANNEL = _BIN_OF * _BINS**2, _BIN_OF * _BINS, _BIN_OF
_SMOOTHED = 0.7  # bins, standard deviation of the Gaussian that smooths a histogram along each axis
_FLOOR = 0.05  # of the probability, spread evenly over all bins: what was not seen has no information
_LARGEST = 3.0  # log-odds of a single pixel


def bins_of(pixels: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Return the index of the histogram's bin of each pixel (..., 3), BGR."""
    blue, green, red = (bins.take(pixels[..., k]) for k, bins in enumerate(_BIN_OF_CHANNEL))
    return np.asarray(blue + green + red)


@dataclass(frozen=True, eq=False)
class ColourModel:
    """Smoothed histograms (B,) of the colours of the instrument and beside it, each of sum one."""

    inside: Float32
    outside: Float32

    @cached_property
    def log_odds(self) -> Float32:
        """The logarithm (B,) of the ratio of the probabilities."""
        floor = np.float32(_FLOOR / self.outside.size)
        return np.clip(np.log((self.inside + floor) / (self.outside + floor)), -_LARGEST, _LARGEST)

    def mixed(self, other: ColourModel, share: float) -> ColourModel:
        """Return the model with a share of another one's histograms."""
        keep, new = np.float32(1 - share), np.float32(share)
        return ColourModel(keep * self.inside + new * other.inside, keep * self.outside + new * other.outside)


Colours = Mapping[str, ColourModel]
"""Colours of instrument and surroundings by view."""


@cache
def _smoothing() -> Float32:
    """Return the matrix that smooths a histogram along one axis."""
    at = np.arange(_BINS)
    kernel = np.exp(-0.5 * ((at[:, None] - at) / _SMOOTHED) ** 2)
    return np.asarray(kernel / kernel.sum(axis=0), np.float32)


def _histogram(bins: NDArray[np.int32]) -> Float32:
    """Return the smoothed histogram (B,) of bins, of sum one."""
    count = np.bincount(bins, minlength=_BINS**3).astype(np.float32)
    for _ in range(3):  # each time along the first axis, which then becomes the last
        count = (_smoothing() @ count.reshape(_BINS, -1)).T
    return np.asarray(count.ravel() / max(float(count.sum()), 1e-9), np.float32)


def learned_colours(image: Image, silhouette: Bool, ignore: Bool | None) -> ColourModel | None:
    """Learn the colours on both sides of a silhouette's outline; None where one side shows too little.

    ``image`` is (H, W, 3) uint8 BGR, ``silhouette`` and ``ignore`` are (H, W).
    """
    if not silhouette.any():
        return None
    left, top, columns, rows = window_around(silhouette, round(_AROUND) + 1)
    part = np.s_[top : top + rows, left : left + columns]
    if silhouette[part].all():
        return None
    distance, bins = signed_distance(silhouette[part]), bins_of(image[part])
    counts = np.ones(distance.shape, np.bool_) if ignore is None else ~ignore[part]
    inside, outside = (counts & (side > _BLURRED) & (side < _AROUND) for side in (-distance, distance))
    if min(int(inside.sum()), int(outside.sum())) < _LEAST_PIXELS:
        return None
    return ColourModel(_histogram(bins[inside]), _histogram(bins[outside]))


def pooled_colours(models: Sequence[ColourModel]) -> ColourModel:
    """Return the model of the mean histograms of at least one model."""
    both = [model.inside for model in models], [model.outside for model in models]
    return ColourModel(*(np.asarray(np.mean(each, axis=0), np.float32) for each in both))


def mask_around(
    image: Image,
    silhouette: Bool,
    colours: ColourModel,
    outside: Bool | None = None,
    spread: float = 0.0,
    passes: int = PASSES,
    longest: int = FINEST,
) -> tuple[Bool, float] | None:
    """Find the mask of the instrument in an image around the silhouette that is expected.

    Parameters
    ----------
    image
        (H, W, 3) uint8 BGR.
    silhouette
        (H, W), the expected one.
    colours
        Colours of the instrument and of its surroundings.
    outside
        (H, W), pixels that are not instrument, such as those outside the field of view.
    spread
        Standard deviation of the expected outline, px.
    passes
        How often the mask is found, each time by the local colours about the outline of the one before.
    longest
        px, longer side of the image, reduced if need be, in which it is found.

    Returns
    -------
    mask, unsupported
        The mask (H, W), and the share of the silhouette without the tool's colours. None where the silhouette is empty
        or full, no pixel is taken for the instrument, or nearly the whole silhouette is without its colours.
    """
    if not silhouette.any():
        return None
    height, width = silhouette.shape
    size, scale = size_within(silhouette.shape, longest)
    small, expected, free = shrunk(image, longest), resized(silhouette, size), around.FREE + spread * scale
    left, top, columns, rows = window_around(expected, round(free + around.REACH) + _MARGIN)
    part, odds = np.s_[top : top + rows, left : left + columns], np.zeros(expected.shape, np.float32)
    odds[part] = _by_colours(small[part], colours)
    prompts = no_prompts(small.shape)
    if outside is not None:
        prompts = prompts.with_outside(resized(outside, size))
    found = around.mask_around(small, expected, free, colours=odds, local=False, prompts=prompts, passes=passes)
    if found is None:
        return None
    unsupported = float((found.by_colour[found.sure] < _LEAST_ODDS).mean()) if found.sure.any() else 0.0
    return (resized(found.mask, (width, height)), unsupported) if unsupported < _NOWHERE else None


def _by_colours(image: Image, colours: ColourModel) -> Float32:
    """Return the log-odds (H, W) of the pixels' colours."""
    odds = colours.log_odds.take(bins_of(image))
    return np.asarray(_COLOURS_WEIGHT * cv2.GaussianBlur(odds, (0, 0), _NOISE), np.float32)
