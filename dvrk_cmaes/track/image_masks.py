"""Masks of an instrument in a recording's images, found around the silhouettes that its calibration expects.

The colours of instrument and surroundings are those of the recording's keyframes, learned at their fitted poses. What
an image shows is decided by these colours, by the edge between the local colours on both sides of the outline, and by
the silhouette, whose outline may be off by as much as the prediction is uncertain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.geometry import Bool, Float32, Image
from dvrk_cmaes.segment import around
from dvrk_cmaes.segment.prompts import no_prompts
from dvrk_cmaes.segment.sizes import FINEST, resized, shrunk, size_within
from dvrk_cmaes.track.histogram_ratio import ColourModel, bins_of

_BLURRED = 2.0  # px from the outline, within which pixels have colours of both sides
_AROUND = 40.0  # px from the outline, within which colours are learned
_LEAST_PIXELS = 200  # on each side of an outline, from which its colours are learned

_COLOURS_WEIGHT = 0.6  # of the log-odds of a pixel's colour: neighbours are alike
_LEAST_ODDS = 0.2  # log-odds by colour, from which on a pixel has the instrument's colours
_NOWHERE = 0.8  # share of the silhouette without these, from which on it shows nothing of the instrument
_NOISE = 1.0  # px, standard deviation of the Gaussian that smooths these log-odds
SPREAD_OF_FIT: Final = 2.0
"""Standard deviation, px, of the outline of a pose that is fitted to an image."""
PASSES: Final = 2
"""Passes in which a mask is found, where the silhouette is that of a prediction."""


@dataclass(frozen=True, eq=False)
class FoundMask:
    """A mask (H, W) found around a silhouette, and the share of that, ``unsupported``, without the tool's colours."""

    mask: Bool
    unsupported: float


def learned_colours(image: Image, silhouette: Bool, ignore: Bool | None) -> ColourModel | None:
    """Learn the colours on both sides of a silhouette's outline; None where one side shows too little.

    ``image`` is (H, W, 3) uint8 BGR, ``silhouette`` and ``ignore`` are (H, W).
    """
    if not silhouette.any() or silhouette.all():
        return None
    distance, bins = signed_distance(silhouette), bins_of(image)
    counts = np.ones_like(silhouette) if ignore is None else ~ignore
    inside, outside = (counts & (side > _BLURRED) & (side < _AROUND) for side in (-distance, distance))
    if min(int(inside.sum()), int(outside.sum())) < _LEAST_PIXELS:
        return None
    return ColourModel.learned([bins[inside]], bins[outside])


def pooled_colours(models: Sequence[ColourModel]) -> ColourModel:
    """Return the model of the mean histograms of at least one model."""
    inside = np.stack([model.inside for model in models]).mean(axis=0)
    outside = np.stack([model.outside for model in models]).mean(axis=0)
    return ColourModel.of(np.asarray(inside, np.float32), np.asarray(outside, np.float32))


def mask_around(
    image: Image,
    silhouette: Bool,
    colours: ColourModel,
    outside: Bool | None = None,
    spread: float = 0.0,
    passes: int = PASSES,
) -> FoundMask | None:
    """Find the mask of the instrument in an image around the silhouette that is expected.

    Parameters
    ----------
    image
        (H, W, 3) uint8 BGR.
    silhouette
        (H, W), the expected one.
    colours
        Colours of the instrument, of one part, and of its surroundings.
    outside
        (H, W), pixels that are not instrument, such as those outside the field of view.
    spread
        Standard deviation of the expected outline, px.
    passes
        How often the mask is found, each time by the local colours about the outline of the one before.

    Returns
    -------
    FoundMask or None
        None where the silhouette is empty or full, no pixel is taken for the instrument, or nearly the whole
        silhouette is without its colours.
    """
    height, width = silhouette.shape
    size, scale = size_within(silhouette.shape, FINEST)
    small = shrunk(image, FINEST)
    prompts = no_prompts(small.shape)
    if outside is not None:
        prompts = prompts.with_outside(resized(outside, size))
    found = around.mask_around(
        small,
        resized(silhouette, size),
        around.FREE + spread * scale,
        colours=_by_colours(small, colours),
        local=False,
        prompts=prompts,
        passes=passes,
    )
    if found is None:
        return None
    unsupported = float((found.by_colour[found.sure] < _LEAST_ODDS).mean()) if found.sure.any() else 0.0
    return FoundMask(resized(found.mask, (width, height)), unsupported) if unsupported < _NOWHERE else None


def _by_colours(image: Image, colours: ColourModel) -> Float32:
    """Return the log-odds (H, W) of the pixels' colours."""
    odds = colours.log_odds[0].take(bins_of(image))
    return np.asarray(_COLOURS_WEIGHT * cv2.GaussianBlur(odds, (0, 0), _NOISE), np.float32)
