"""Segmentation by colours, edges and position in the image, without learned weights.

`_segment_reduced` works at a reduced size: it cuts out the pixels that are grey rather than colourful by a graph cut,
keeps the region that meets the image's border, takes colour histograms of that region and of its surroundings, and
repeats the graph cut with the log-odds of these histograms. `refine_outline` then works at full size in a band along
the outline, with the colours near the outline, the edge position and the straight sides of the shaft. Prompts (a box,
points) fix the labels of the pixels that they determine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.frames.field_of_view import outside_view
from dvrk_cmaes.segment.colours import Colours, ColourTable, greyness_log_odds, measure_colours
from dvrk_cmaes.segment.confidence import GUESS, assess_mask
from dvrk_cmaes.segment.edge_colours import edge_log_odds
from dvrk_cmaes.segment.graph_cut import cut
from dvrk_cmaes.segment.prompts import Prompts, draw_prompts
from dvrk_cmaes.segment.regions import distance_to, fill_holes, instrument_region
from dvrk_cmaes.segment.segmentation import Box, Pixel, Segmentation
from dvrk_cmaes.segment.shaft_sides import shaft_log_odds
from dvrk_cmaes.segment.sizes import resized, shrunk, size_within

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]

# lengths without a unit are fractions of the image's longer side
_SMALLEST = 8  # px, least shorter side of an image that is segmented
_REDUCED = 320  # px, the longer side at the reduced size
# (share of the instrument that may have any colour, largest number of iterations); a large share lets the mask grow
# into parts whose colours are not in the mask yet, such as the wrist
_SCHEDULE = ((0.5, 8), (0.1, 2), (0.02, 2))
_CONVERGED = 0.97  # IoU of the masks of two successive iterations, above which the iteration stops
_REACH = 0.125  # largest distance from the last mask at which a pixel may be labelled instrument
_AROUND = 0.19  # largest distance from the mask of the pixels that the background's histogram is taken from
_GAP = 0.06  # largest distance between pieces of an instrument, at the reduced size
_PRIOR_WEIGHT, _LARGEST_PRIOR = 0.3, 2.0  # weight of the greyness log-odds beside the histograms', and their bound
_LARGEST_ODDS = 4.0  # bound of the histograms' log-odds
_BIASES = (1.0, 2.0, 3.0)  # log-odds added to the prior in further attempts, if the mask does not fill its box
_ENOUGH_OVERLAP = 0.9  # IoU of the mask's bounding box and the given box, from which no further bias is tried

_FINEST = 1000  # px, longer side above which an image is refined at a reduced size
_FINE_ITERATIONS = 3
_COLOURS_WEIGHT = 0.4  # weight of the histograms' log-odds beside those of the edge position
_BAND = 10.0  # px, largest distance by which the mask may grow in an iteration
_COLOUR_DECAY = 12.0  # px; pixels are weighted in the histograms by exp(-distance from the outline / this)
_FINE_GAP = 0.02  # as _GAP, at full size
_MARGIN = 0.06  # margin of the window about a mask at full size


def segment_classic(
    image: NDArray[np.uint8],
    *,
    box: Box | None = None,
    points: Sequence[Pixel] = (),
    not_points: Sequence[Pixel] = (),
) -> Segmentation:
    """Segment the instrument in an image (H, W, 3) uint8 BGR; prompts as in `dvrk_cmaes.segment.segment`."""
    height, width = image.shape[:2]
    if min(height, width) < _SMALLEST:
        return Segmentation(np.zeros((height, width), np.bool_), None, 0.0, ("no instrument found",))
    small, scale = shrunk(image, _REDUCED), size_within(image.shape, _REDUCED)[1]
    rough = _segment_reduced(
        measure_colours(small),
        draw_prompts(small.shape, scale, box, points, not_points).with_outside(outside_view(small)),
    )
    prompts = draw_prompts(image.shape, 1.0, box, points, not_points).with_outside(outside_view(image))
    found = refine_outline(image, resized(rough, (width, height)), prompts)
    return found if prompts.outside is None else replace(found, mask=found.mask & ~prompts.outside)


def refine_outline(
    image: NDArray[np.uint8], rough: Bool, prompts: Prompts, odds: Float32 | None = None
) -> Segmentation:
    """Move the outline of a rough mask to the edges of the instrument in the image.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    rough
        (H, W), the mask.
    prompts
        Prompts in pixels of the image.
    odds
        (H, W), additional log-odds of instrument; by default those of the shaft's sides (`shaft_log_odds`), if the
        shaft's sides are found.

    Returns
    -------
    Segmentation
        Empty, with confidence 0, if ``rough`` is empty or covers the whole image.
    """
    if not rough.any() or rough.all():
        return Segmentation(np.zeros_like(rough), None, 0.0, ("no instrument found",))
    longer = max(rough.shape)
    if longer > _FINEST:
        return _refine_reduced(image, rough, prompts, odds)
    left, top, width, height = window_around(rough, max(round(_MARGIN * longer), 2))
    window = np.s_[top : top + height, left : left + width]
    colours, mask = measure_colours(np.ascontiguousarray(image[window])), rough[window]
    table, prompts_here = ColourTable(colours), prompts.within(window)
    refined = rough.copy()
    for _ in range(_FINE_ITERATIONS):
        refined[window] = mask
        known = shaft_log_odds(refined) if odds is None else odds
        by_colour = local_colour_log_odds(table, mask)
        total = _COLOURS_WEIGHT * by_colour + edge_log_odds(image[window], mask)
        if known is not None:
            total += known[window]
        mask = _cut(total, colours, prompts_here, distance_to(mask) > _BAND)
        if not mask.any() or mask.all():
            break
    score = np.zeros(rough.shape, np.float32)
    refined[window] = mask
    refined = fill_holes(instrument_region(refined, _FINE_GAP * longer, prompts))
    score[window] = 1 / (1 + np.exp(-total))
    verdict = assess_mask(refined, window, by_colour, colours, prompts=prompts)
    notes = verdict.notes
    if verdict.confidence < GUESS:
        notes = ("a guess", *notes)
    return Segmentation(refined, score, verdict.confidence, notes)


def _refine_reduced(image: NDArray[np.uint8], rough: Bool, prompts: Prompts, odds: Float32 | None) -> Segmentation:
    """Refine an outline in a reduced image, and return the result at the original size."""
    height, width = rough.shape
    size, scale = size_within(rough.shape, _FINEST)
    reduced = refine_outline(
        shrunk(image, _FINEST),
        resized(rough, size),
        prompts.resized(*size, scale),
        None if odds is None else np.asarray(cv2.resize(odds, size, interpolation=cv2.INTER_AREA), np.float32),
    )
    score = None if reduced.score is None else np.asarray(cv2.resize(reduced.score, (width, height)), np.float32)
    return replace(reduced, mask=resized(reduced.mask, (width, height)), score=score)


def local_colour_log_odds(table: ColourTable, mask: Bool) -> Float32:
    """Return log-odds of instrument (H, W) by colour histograms inside and outside a mask, taken near its outline."""
    inside, outside = (np.exp(-distance_to(~side) / _COLOUR_DECAY) * side for side in (mask, ~mask))
    return np.clip(table.log_odds(inside, outside), -_LARGEST_ODDS, _LARGEST_ODDS)


def _segment_reduced(colours: Colours, prompts: Prompts) -> Bool:
    """Segment an image at a reduced size, (H, W).

    With a box, biases are added to the prior's log-odds, and the mask whose bounding box has the largest overlap with
    the given box is returned.
    """
    prior = greyness_log_odds(colours, prompts.around_box, prompts.tool, any_colour=prompts.box is not None)
    table = ColourTable(colours)
    mask = _iterate_cuts(colours, table, prior, prompts)
    if prompts.box is None:
        return mask
    best = _box_overlap(mask, prompts.box)
    for bias in _BIASES:
        if best >= _ENOUGH_OVERLAP:
            break
        other = _iterate_cuts(colours, table, prior + np.float32(bias), prompts)
        overlap = _box_overlap(other, prompts.box)
        if overlap > best + 0.01:
            best, mask = overlap, other
    return mask


def _iterate_cuts(colours: Colours, table: ColourTable, prior: Float32, prompts: Prompts) -> Bool:
    """Alternate graph cut and colour histograms, starting from the log-odds ``prior`` (H, W); returns a mask (H, W)."""
    longer = max(colours.shape)
    mask = instrument_region(_cut(prior, colours, prompts), _GAP * longer, prompts)
    for unseen, iterations in _SCHEDULE:
        for _ in range(iterations):
            if not mask.any():
                return mask
            away = distance_to(mask)
            odds = table.log_odds(mask, (away > 2) & (away < _AROUND * longer), unseen=unseen)
            odds = np.clip(odds, -_LARGEST_ODDS, _LARGEST_ODDS)
            odds += _PRIOR_WEIGHT * np.clip(prior, -_LARGEST_PRIOR, _LARGEST_PRIOR)
            before, mask = mask, _cut(odds, colours, prompts, away > _REACH * longer)
            mask = instrument_region(mask, _GAP * longer, prompts)
            if (before & mask).sum() > _CONVERGED * (before | mask).sum():
                break
    return fill_holes(mask)


def _box_overlap(mask: Bool, box: Box) -> float:
    """Return the overlap (intersection over union) of a box and the bounding box of a mask; 0 for an empty mask."""
    if not mask.any():
        return 0.0
    left, top, width, height = window_around(mask, 0)
    across = min(box[2], left + width - 1) - max(box[0], left) + 1
    down = min(box[3], top + height - 1) - max(box[1], top) + 1
    both = max(across, 0.0) * max(down, 0.0)
    return both / ((box[2] - box[0] + 1) * (box[3] - box[1] + 1) + width * height - both)


def _cut(odds: Float32, colours: Colours, prompts: Prompts, far: Bool | None = None) -> Bool:
    """Cut by log-odds (H, W); prompts fix the labels of their pixels, and pixels of ``far`` (H, W) are background."""
    background = prompts.background
    if far is not None:
        background = far if background is None else background | far
    return cut(odds, colours.guide, background=background, tool=prompts.tool)
