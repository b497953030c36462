"""The mask of an instrument around a silhouette that is expected: the one cut of all masks of a known shape.

Each pixel has log-odds by its colour, by the edge between the local colours on both sides of the outline, and by the
silhouette: none near its outline, which may be off by as much as the pose is unsure, and more with the distance beyond.
A minimum graph cut follows the edges of the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.geometry import Bool, Float32, Image
from dvrk_cmaes.segment.colours import Colours, ColourTable, brightest, local_colour_log_odds, measure_colours
from dvrk_cmaes.segment.confidence import assess_mask
from dvrk_cmaes.segment.edge_colours import edge_log_odds
from dvrk_cmaes.segment.graph_cut import cut, levels
from dvrk_cmaes.segment.prompts import Prompts, no_prompts
from dvrk_cmaes.segment.regions import fill_holes
from dvrk_cmaes.segment.segmentation import Segmentation, nothing_found
from dvrk_cmaes.segment.shaft_sides import shaft_log_odds
from dvrk_cmaes.segment.sizes import FINEST, resized, shrunk, size_within

FREE: Final = 3.0
"""px on either side of a silhouette's outline, in which a silhouette that is known well has no say."""
ROUGH: Final = 10.0
"""px on either side of the outline of a rough mask that was found in the image, likewise."""
_REFINED: Final = 8.0  # px, likewise of a mask that was refined before
_COARSEST: Final = 480  # px, longer side at which an outline is refined first, at least
REACH: Final = 12.0
"""px beyond the free band, from which on nothing is instrument."""

_STEEPNESS: Final = 0.5  # log-odds per px beyond the free band
_LARGEST_PRIOR: Final = 3.0  # log-odds by the silhouette
_COLOURS_WEIGHT: Final = 0.4  # of the log-odds by the colours near the outline
_PASSES: Final = 2
_MARGIN: Final = 2  # px about the pixels that may be instrument: colours are sorted by those of the window
_NOISE: Final = 1.0  # px, standard deviation of the Gaussian that smooths the features whose edges are followed
_BLURRED: Final = 2.0  # px from the band, within which a piece of a mask is near the silhouette
_LEAST_WITHIN: Final = 0.5  # share of such a piece that lies near the silhouette
_LEAST_PIECE: Final = 20  # px
_SETTLED: Final = 0.002  # share of the mask's pixels that change, below which no further pass is made


@dataclass(frozen=True, eq=False)
class Around:
    """A mask (H, W) around a silhouette, and the window (rows, columns) that was looked at.

    ``by_colour`` are the log-odds (h, w) by colours in the window, ``sure`` its pixels (h, w) that are the instrument's
    by the silhouette, ``measured`` its colours, if these were learned. All are of the size at which the mask was found.
    """

    mask: Bool
    window: tuple[slice, slice]
    by_colour: Float32
    sure: Bool
    measured: Colours | None


def mask_around(
    image: Image,
    silhouette: Bool,
    free: float | Float32 = FREE,
    *,
    reach: float | Float32 = REACH,
    steepness: float = _STEEPNESS,
    colours: Float32 | None = None,
    local: bool = True,
    edges: bool = True,
    straight: bool = False,
    prompts: Prompts | None = None,
    passes: int = _PASSES,
) -> Around | None:
    """Find the mask of the instrument in an image around a silhouette.

    Parameters
    ----------
    image
        (H, W, 3) uint8 BGR, of at most `FINEST` px.
    silhouette
        (H, W), the expected one.
    free
        px about its outline, in which it has no say; of all pixels, or of each, (H, W).
    reach
        px beyond that, from which on nothing is instrument; likewise.
    steepness
        Log-odds by the silhouette for each px beyond the free band.
    colours
        (H, W), log-odds by colours that are known.
    local
        Whether the colours on both sides of the outline are learned in the image, too.
    edges
        Whether the edges between local colours count: where the silhouette is known roughly, shadows have such edges.
    straight
        Whether the sides of the shaft are made straight, where these are found.
    prompts
        Pixels whose label is given.
    passes
        How often the mask is found, at most, each time by the local colours about the outline of the one before.

    Returns
    -------
    Around or None
        None where the silhouette is empty or full, or no pixel is taken for the instrument.
    """
    if not silhouette.any() or silhouette.all():
        return None
    left, top, width, height = window_around(silhouette, round(float(np.max(np.add(free, reach)))) + _MARGIN)
    window = np.s_[top : top + height, left : left + width]
    part, expected = np.ascontiguousarray(image[window]), silhouette[window]
    if expected.all():
        return None
    band, far = (np.broadcast_to(np.float32(each), silhouette.shape)[window] for each in (free, reach))
    distance = signed_distance(expected)
    prior = log_odds_beyond(distance, band, steepness)
    fixed = no_prompts(silhouette.shape) if prompts is None else prompts
    background, tool = fixed.background[window], fixed.tool[window]
    never = background | (distance > band + far)
    measured = measure_colours(part) if local else None
    table = None if measured is None else ColourTable(measured)
    known = np.zeros(prior.shape, np.float32) if colours is None else colours[window]
    features, mask, by_colour = levels(guide(part) if measured is None else measured.guide), expected, known
    for number in range(passes):
        if table is not None:
            by_colour = known + _COLOURS_WEIGHT * local_colour_log_odds(table, mask)
        odds = by_colour + prior
        if edges:
            odds += edge_log_odds(part, signed_distance(mask) if number else distance)
        if straight and (sides := shaft_log_odds(mask, silhouette.shape, window)) is not None:
            odds += sides
        before, mask = mask, cut(np.asarray(odds, np.float32), features, background=never, tool=tool)
        if not mask.any() or mask.all():
            return None
        if np.count_nonzero(before ^ mask) < _SETTLED * np.count_nonzero(mask):
            break
    whole = np.zeros_like(silhouette)
    whole[window] = _within(mask, distance < np.minimum(band, ROUGH) + _BLURRED)
    whole = fill_holes(whole)
    whole[window] &= ~background
    sure = expected & (distance < -band) & ~never
    return Around(whole, window, by_colour, sure, measured) if whole.any() else None


def log_odds_beyond(distance: Float32, free: float | Float32 = FREE, steepness: float = _STEEPNESS) -> Float32:
    """Return log-odds of instrument (H, W) by the signed distance from the outline of a silhouette, px."""
    beyond = np.sign(distance) * np.maximum(np.abs(distance) - free, 0)
    return np.clip(-steepness * beyond, -_LARGEST_PRIOR, _LARGEST_PRIOR).astype(np.float32)


def segmentation_around(
    image: Image,
    silhouette: Bool,
    prompts: Prompts,
    *,
    rough: bool = False,
    colours: Float32 | None = None,
    local: bool = True,
    free: float | Float32 = FREE,
) -> Segmentation:
    """Segment an image (H, W, 3) uint8 BGR around a silhouette (H, W), as `mask_around`, and assess the mask.

    A ``rough`` silhouette is a mask that was found at a reduced size, and is a shaft's with straight sides: it is first
    refined, at half the size if the image is large. ``colours`` are of any size; without ``local`` they count alone.
    ``free`` is as there, of the size at which the mask is found, where the silhouette is not rough.
    """
    longest, expected = min(max(silhouette.shape), FINEST), silhouette
    steps: list[tuple[int, float | Float32, int]] = [(longest, free, _PASSES)]
    if rough:
        half = longest // 2 if longest // 2 >= _COARSEST else longest
        steps = [(half, ROUGH * half / longest, _PASSES), (longest, _REFINED, 1)]
    for size, band, passes in steps:
        at, scale = size_within(silhouette.shape, size)
        small, fixed = shrunk(image, size), prompts.resized(*at, scale) if scale < 1 else prompts
        found = mask_around(
            small,
            resized(expected, at),
            band,
            colours=None if colours is None else np.asarray(cv2.resize(colours, at), np.float32),
            local=local,
            edges=local,
            straight=rough,
            prompts=fixed,
            passes=passes,
        )
        if found is None:
            return nothing_found(silhouette.shape)
        expected = found.mask
    assert found is not None
    measured = found.measured or measure_colours(np.ascontiguousarray(small[found.window]))
    judged = assess_mask(found.mask, found.window, found.by_colour, measured, prompts=fixed)
    return Segmentation(resized(found.mask, silhouette.shape[1::-1]), *judged)


def guide(image: Image) -> Float32:
    """Return the features of an image (H, W, 2) whose edges an outline follows: brightness and colourfulness."""
    smooth = cv2.GaussianBlur(image, (0, 0), _NOISE).astype(np.float32) + 8.0
    colourful = np.log(smooth[..., 2] / smooth[..., 1])
    return np.stack([np.log(brightest(smooth)), colourful], axis=-1)


def _within(mask: Bool, near: Bool) -> Bool:
    """Keep the pieces of a mask that lie mostly ``near`` the silhouette; what hides a part of it divides it."""
    count, labels, measures, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    area = measures[:, cv2.CC_STAT_AREA]
    share = np.bincount(labels[near], minlength=count) / np.maximum(area, 1)
    kept = (share >= _LEAST_WITHIN) & (area >= min(_LEAST_PIECE, area[1:].max(initial=0)))
    kept[0] = False
    return np.asarray(kept[labels])
