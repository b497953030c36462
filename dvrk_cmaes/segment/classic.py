"""The instrument in an image by its colours, edges and place, without weights.

First at a reduced size (`_rough`): where is it grey rather than colourful, cut out smoothly; keep the region that comes
in from the border; count its colours and those around it, and cut again by these, a few times. Then at full size
(`refine_outline`), in a band along that outline, by the colours just beside it and the straight sides of the shaft. A
box or points, where given, take the place of guesses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.segment.colours import Colours, ColourTable, greyness, look
from dvrk_cmaes.segment.confidence import GUESS, trust
from dvrk_cmaes.segment.edge_colours import halfway_odds
from dvrk_cmaes.segment.field_of_view import outside_view
from dvrk_cmaes.segment.graph_cut import cut
from dvrk_cmaes.segment.prompts import Prompts, draw_prompts
from dvrk_cmaes.segment.regions import distance_to, instrument_region, without_holes
from dvrk_cmaes.segment.segmentation import Box, Pixel, Segmentation
from dvrk_cmaes.segment.shaft_sides import shaft_odds

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]

# lengths without a unit are shares of the image's longer side
_SMALLEST = 8  # px, the shorter side of an image in which there is anything to find
_REDUCED = 320  # px, the longer side at the reduced size
_UNSEEN = ((0.5, 8), (0.1, 2), (0.02, 2))  # of the instrument, in at most so many rounds: the wrist is found last
_SETTLED = 0.97  # overlap of a mask with the last round's at which more rounds change nothing
_REACH = 0.125  # how far beyond a mask the instrument may go on
_AROUND = 0.19  # how far the background beside the instrument goes
_GAP = 0.06  # between pieces of an instrument, at the reduced size
_PRIOR_WEIGHT, _LARGEST_PRIOR = 0.3, 2.0  # of greyness beside counted colours, and its log-odds
_LARGEST_ODDS = 4.0  # by counted colours
_BIASES = (1.0, 2.0, 3.0)  # log-odds added at first, for a mask that does not fill its box
_FILLED = 0.9  # overlap of a box with the one around the mask that will do

_FINEST = 1000  # px, the longer side of the largest image that is looked at
_FINE_ROUNDS = 3
_COLOURS_WEIGHT = 0.4  # of counted colours beside the halfway place
_BAND = 10.0  # px of the full image either side of an outline, within which it may move
_BESIDE = 12.0  # px of the full image: colours count by exp(-distance from the outline / this)
_FINE_GAP = 0.02
_MARGIN = 0.06  # of the window about a mask at full size


def segment_classic(
    image: NDArray[np.uint8],
    *,
    box: Box | None = None,
    points: Sequence[Pixel] = (),
    not_points: Sequence[Pixel] = (),
) -> Segmentation:
    """Find the instrument in an image (H, W, 3) uint8 BGR, with prompts as in `dvrk_cmaes.segment.segment`."""
    height, width = image.shape[:2]
    if min(height, width) < _SMALLEST:
        return Segmentation(np.zeros((height, width), np.bool_), None, 0.0, ("no instrument found",))
    scale = min(_REDUCED / max(height, width), 1.0)
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    rough = _rough(look(small), draw_prompts(small.shape, scale, box, points, not_points).seen(outside_view(small)))
    enlarged = cv2.resize(rough.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.5
    prompts = draw_prompts(image.shape, 1.0, box, points, not_points).seen(outside_view(image))
    return refine_outline(image, np.asarray(enlarged), prompts)


def refine_outline(
    image: NDArray[np.uint8], rough: Bool, prompts: Prompts, odds: Float32 | None = None
) -> Segmentation:
    """Bring a rough mask's outline to where the image has it.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    rough
        (H, W), the mask.
    prompts
        In pixels of the image.
    odds
        (H, W), log-odds of instrument by what else is known; unless given, by the sides of the shaft, if any are found.
    """
    if not rough.any() or rough.all():
        return Segmentation(np.zeros_like(rough), None, 0.0, ("no instrument found",))
    longer = max(rough.shape)
    if longer > _FINEST:
        return _refined_smaller(image, rough, prompts, odds, _FINEST / longer)
    left, top, width, height = window_around(rough, max(round(_MARGIN * longer), 2))
    window = np.s_[top : top + height, left : left + width]
    colours, mask = look(np.ascontiguousarray(image[window])), rough[window]
    table, asked = ColourTable(colours), prompts.within(window)
    found = rough.copy()
    for _ in range(_FINE_ROUNDS):
        found[window] = mask
        known = shaft_odds(found) if odds is None else odds
        by_colour = beside_odds(table, mask)
        total = _COLOURS_WEIGHT * by_colour + halfway_odds(image[window], mask)
        if known is not None:
            total += known[window]
        mask = _cut(total, colours, asked, distance_to(mask) > _BAND)
        if not mask.any() or mask.all():
            break
    score = np.zeros(rough.shape, np.float32)
    found[window] = mask
    found = without_holes(instrument_region(found, _FINE_GAP * longer, prompts))
    score[window] = 1 / (1 + np.exp(-total))
    verdict = trust(found, window, by_colour, colours, prompts=prompts)
    notes = verdict.notes
    if verdict.confidence < GUESS:
        notes = ("a guess", *notes)
    return Segmentation(found, score, verdict.confidence, notes)


def _refined_smaller(
    image: NDArray[np.uint8], rough: Bool, prompts: Prompts, odds: Float32 | None, scale: float
) -> Segmentation:
    """Refine an outline in a smaller image, and enlarge what comes of it."""
    height, width = rough.shape
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    found = refine_outline(
        np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8),
        np.asarray(cv2.resize(rough.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5),
        prompts.resized(*size, scale),
        None if odds is None else np.asarray(cv2.resize(odds, size, interpolation=cv2.INTER_AREA), np.float32),
    )
    mask = cv2.resize(found.mask.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.5
    score = None if found.score is None else np.asarray(cv2.resize(found.score, (width, height)), np.float32)
    return replace(found, mask=np.asarray(mask), score=score)


def beside_odds(table: ColourTable, mask: Bool) -> Float32:
    """Log-odds (H, W) by the colours on a mask and off it, those near its outline counting most."""
    inside, outside = (np.exp(-distance_to(~side) / _BESIDE) * side for side in (mask, ~mask))
    return np.clip(table.log_odds(inside, outside), -_LARGEST_ODDS, _LARGEST_ODDS)


def _rough(colours: Colours, prompts: Prompts) -> Bool:
    """Find the instrument at a reduced size, (H, W): with a box, with the bias that makes it fill the box best."""
    prior = greyness(colours, prompts.around_box, prompts.tool, any_colour=prompts.box is not None)
    table = ColourTable(colours)
    mask = _rounds(colours, table, prior, prompts)
    if prompts.box is None:
        return mask
    best = _filling(mask, prompts.box)
    for bias in _BIASES:
        if best >= _FILLED:
            break
        other = _rounds(colours, table, prior + np.float32(bias), prompts)
        filling = _filling(other, prompts.box)
        if filling > best + 0.01:
            best, mask = filling, other
    return mask


def _rounds(colours: Colours, table: ColourTable, prior: Float32, prompts: Prompts) -> Bool:
    """Cut by a prior, and then again and again by the colours that were found, (H, W)."""
    longer = max(colours.shape)
    mask = instrument_region(_cut(prior, colours, prompts), _GAP * longer, prompts)
    for unseen, rounds in _UNSEEN:
        for _ in range(rounds):
            if not mask.any():
                return mask
            away = distance_to(mask)
            odds = table.log_odds(mask, (away > 2) & (away < _AROUND * longer), unseen=unseen)
            odds = np.clip(odds, -_LARGEST_ODDS, _LARGEST_ODDS)
            odds += _PRIOR_WEIGHT * np.clip(prior, -_LARGEST_PRIOR, _LARGEST_PRIOR)
            before, mask = mask, _cut(odds, colours, prompts, away > _REACH * longer)
            mask = instrument_region(mask, _GAP * longer, prompts)
            if (before & mask).sum() > _SETTLED * (before | mask).sum():
                break
    return without_holes(mask)


def _filling(mask: Bool, box: Box) -> float:
    """Overlap (intersection over union) of a box and the box around a mask."""
    if not mask.any():
        return 0.0
    left, top, width, height = window_around(mask, 0)
    across = min(box[2], left + width - 1) - max(box[0], left) + 1
    down = min(box[3], top + height - 1) - max(box[1], top) + 1
    both = max(across, 0.0) * max(down, 0.0)
    return both / ((box[2] - box[0] + 1) * (box[3] - box[1] + 1) + width * height - both)


def _cut(odds: Float32, colours: Colours, prompts: Prompts, far: Bool | None = None) -> Bool:
    """Cut by log-odds, within what prompts allow and not ``far`` away."""
    background = prompts.background
    if far is not None:
        background = far if background is None else background | far
    return cut(odds, colours.guide, background=background, tool=prompts.tool)
