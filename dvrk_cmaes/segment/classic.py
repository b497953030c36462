"""Segmentation by colours, edges and position in the image, without learned weights.

`rough_mask` works at a reduced size: it cuts out the pixels that are grey rather than colourful by a graph cut,
keeps the region that meets the image's border, takes colour histograms of that region and of its surroundings, and
repeats the graph cut with the log-odds of these histograms. `around` then moves the outline to the image's edges at
full size. Prompts (a box, points) fix the labels of the pixels that they determine.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dvrk_cmaes.geometry import Bool, Float32, Image
from dvrk_cmaes.segment.around import segmentation_around
from dvrk_cmaes.segment.colours import (
    LARGEST_COLOUR_ODDS,
    Colours,
    ColourTable,
    greyness_log_odds,
    local_colour_log_odds,
    measure_colours,
)
from dvrk_cmaes.segment.confidence import assess_mask
from dvrk_cmaes.segment.graph_cut import cut, levels
from dvrk_cmaes.segment.prompts import Prompts, draw_prompts
from dvrk_cmaes.segment.regions import (
    REDUCED,
    SMALLEST,
    distance_to,
    fill_holes,
    instrument_region,
    resized,
    shrunk,
    size_within,
)
from dvrk_cmaes.segment.segmentation import Hints, Segmentation, nothing_found

# lengths without a unit are fractions of the image's longer side
# (share of the instrument that may have any colour, largest number of iterations); a large share lets the mask grow
# into parts whose colours are not in the mask yet, such as the wrist
_SCHEDULE = ((0.5, 8), (0.1, 2), (0.02, 2))
_CONVERGED = 0.97  # IoU of the masks of two successive iterations, above which the iteration stops
_REACH = 0.125  # largest distance from the last mask at which a pixel may be labelled instrument
_AROUND = 0.19  # largest distance from the mask of the pixels that the background's histogram is taken from
GAP = 0.06  # largest distance between pieces of an instrument, at the reduced size
_PRIOR_WEIGHT, _LARGEST_PRIOR = 0.3, 2.0  # weight of the greyness log-odds against the histograms', and their bound


def rough_mask(image: Image, hints: Hints) -> Segmentation:
    """Find the mask of the instrument in an image (H, W, 3) uint8 BGR at a reduced size, of which it is."""
    height, width = image.shape[:2]
    small, scale = shrunk(image, REDUCED), size_within(image.shape, REDUCED)[1]
    if min(height, width) < SMALLEST:
        return nothing_found(small.shape)
    prompts = draw_prompts(small, hints, scale)
    colours = measure_colours(small)
    prior = greyness_log_odds(colours)
    table = ColourTable(colours)
    mask = _iterate_cuts(colours, table, prior, prompts)
    odds = local_colour_log_odds(table, mask)
    return Segmentation(mask, *assess_mask(mask, np.s_[:, :], odds, colours, prompts=prompts))


def segment_classic(image: Image, prompts: Prompts, rough: Segmentation) -> Segmentation:
    """Segment the instrument in an image (H, W, 3) uint8 BGR, given its `rough_mask`."""
    found = segmentation_around(image, resized(rough.mask, (image.shape[1], image.shape[0])), prompts, rough=True)
    return replace(found, mask=found.mask & ~prompts.outside)


def _iterate_cuts(colours: Colours, table: ColourTable, prior: Float32, prompts: Prompts) -> Bool:
    """Alternate graph cut and colour histograms, starting from the log-odds ``prior`` (H, W); returns a mask (H, W)."""
    longer = max(colours.shape)
    guide = levels(colours.guide)
    mask = cut(prior, guide, background=prompts.background, tool=prompts.tool)
    mask = instrument_region(mask, GAP * longer, prompts)
    for unseen, iterations in _SCHEDULE:
        for _ in range(iterations):
            if not mask.any():
                return mask
            away = distance_to(mask)
            odds = table.log_odds(mask, (away > 2) & (away < _AROUND * longer), unseen=unseen)
            odds = np.clip(odds, -LARGEST_COLOUR_ODDS, LARGEST_COLOUR_ODDS)
            odds += _PRIOR_WEIGHT * np.clip(prior, -_LARGEST_PRIOR, _LARGEST_PRIOR)
            far = prompts.background | (away > _REACH * longer)
            before, mask = mask, cut(odds, guide, background=far, tool=prompts.tool)
            mask = instrument_region(mask, GAP * longer, prompts)
            if (before & mask).sum() > _CONVERGED * (before | mask).sum():
                break
    return fill_holes(mask)
