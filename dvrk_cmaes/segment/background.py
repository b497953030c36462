"""Segmentation by what differs from the background: on a bench the instrument moves before a camera that stands still.

The background of each pixel is the value that the images agree on most closely; images in which the instrument is near
the pixel are then left out. Of a single image, it is a smooth surface that fits most pixels, as of paper under a lamp.

A pixel belongs to the instrument if its brightness or colour is far from the background's. A shadow beside the
instrument is less far, has no edge of its own, and is left out by a graph cut along the edges of the image.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.geometry import Bool, Float32, Image
from dvrk_cmaes.segment.around import log_odds_beyond
from dvrk_cmaes.segment.colours import measure_colours
from dvrk_cmaes.segment.confidence import assess_mask
from dvrk_cmaes.segment.edge_colours import edge_log_odds
from dvrk_cmaes.segment.graph_cut import cut
from dvrk_cmaes.segment.prompts import Prompts
from dvrk_cmaes.segment.regions import distance_to, fill_holes, instrument_region
from dvrk_cmaes.segment.segmentation import Segmentation, noted
from dvrk_cmaes.segment.shaft_sides import shaft_log_odds
from dvrk_cmaes.segment.sizes import FINEST, SMALLEST, shrunk

FEWEST: Final = 8
"""Images from which a background, or what moves before it, is learned, at least."""
MOST: Final = 40
"""Images from which a background is learned, at most."""

_AGREEING: Final = 0.3  # share of the images whose closest values show a pixel's background
_STANDING: Final = 0.6, 75.0, 4.0  # of share 0.6 of the images, 75 % of the pixels differ by at most 4 grey levels
_PASSES: Final = 2  # in which images with the instrument near a pixel are left out
_MARGIN: Final = 0.03  # of the longer side; shadows reach that far
_LEAST_FREE: Final = 3  # images without the instrument near a pixel
_ROWS: Final = 64  # that are worked on at once, to bound memory

_DARK: Final = 3.0  # grey levels added before logarithms, so that noise in the dark does not count
_RATIO: Final = np.array([-0.7, -0.5, -0.38, -0.28, -0.12, -0.06, 0.06, 0.12, 0.3])
_ODDS: Final = np.array([4.0, 3.0, 1.0, -0.3, -1.0, -4.0, -4.0, 0.0, 3.0])
"""Log-odds of instrument by the logarithm of brightness against the background's; shadows are about -0.25."""
_LARGEST_PRIOR: Final = 2.0  # log-odds by sides or silhouette, which what surely differs outweighs
_FAR: Final = 0.04  # of the longer side; farther from what surely differs there is no instrument
_CUTS: Final = 3
_GAP: Final = 0.04  # of the longer side, between pieces of an instrument
_CLOSING: Final = 0.011  # of the longer side: highlights at the outline are closed
_NEARBY: Final = 20  # px about the pixels that may be instrument, in which the image is looked at
_WEIGHT: Final = 4.0
"""Factor on the log-odds: in a window about the instrument edges are dense, and the graph cut takes each for weaker."""
_EDGE: Final = 2.5  # px by which the outline is moved to an edge, at most
_WINDOW: Final = 0.06  # of the longer side, about the mask, in which it is assessed
_SURFACE: Final = 160  # px, longer side at which it is fitted
_SURFACE_PASSES: Final = 8
_NEAR_SURFACE: Final = 0.05  # logarithm of brightness
_LEAST_SURFACE: Final = 0.4  # share of the pixels that a smooth background fits


def learn_background(images: Sequence[Image]) -> Image | None:
    """Learn the background from images (H, W, 3) uint8 BGR of a camera that stands still.

    Returns it at a size of at most 1000 px, (h, w, 3); None if the images are too few, of several sizes, or show no
    background that stands still.
    """
    if len(images) < FEWEST or len({image.shape for image in images}) > 1:
        return None
    stack = np.stack([shrunk(image, FINEST) for image in images])
    found, spread = np.empty(stack.shape[1:], np.uint8), np.empty(stack.shape[1:3], np.float32)
    for rows in _blocks(stack.shape[1]):
        found[rows], spread[rows] = _closest_values(stack[:, rows])
    _, percentile, levels = _STANDING
    if np.percentile(spread, percentile) > levels:
        return None
    for _ in range(_PASSES):
        free = np.stack([_free_of_instrument(image, found) for image in stack])
        for rows in _blocks(stack.shape[1]):
            found[rows] = _median_of_free(stack[:, rows], free[:, rows], found[rows])
    return found


def smooth_background(image: Image) -> Image | None:
    """Fit a smooth background to one image (H, W, 3) uint8 BGR; None if it does not fit 40 % of the pixels."""
    small = shrunk(image, _SURFACE)
    height, width = small.shape[:2]
    if min(height, width) < SMALLEST:
        return None
    v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v, u**4, v**4, u * u * v * v], axis=-1).reshape(-1, 9)
    values = np.log(small.reshape(-1, 3) + _DARK)
    brightness = values.mean(axis=1)
    near = np.abs(brightness - _most_frequent(brightness)) < 6 * _NEAR_SURFACE
    for _ in range(_SURFACE_PASSES):
        if near.mean() < _LEAST_SURFACE / 2:
            return None
        weights = np.linalg.lstsq(terms[near], values[near], rcond=None)[0]
        near = np.abs(values - terms @ weights).max(axis=1) < _NEAR_SURFACE
    if near.mean() < _LEAST_SURFACE:
        return None
    surface = np.exp(terms @ weights).reshape(height, width, 3) - _DARK
    return np.asarray(np.clip(surface + 0.5, 0, 255), np.uint8)


def segment_before(image: Image, background: Image, prompts: Prompts, silhouette: Bool | None = None) -> Segmentation:
    """Segment what is before a background.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    background
        (h, w, 3), of any size.
    prompts
        Prompts in pixels of the image.
    silhouette
        (H, W), neither empty nor full, around which the instrument is; by default the shaft's sides tell where.
    """
    height, width = image.shape[:2]
    longer = max(height, width)
    behind = cv2.resize(background, (width, height), interpolation=cv2.INTER_LINEAR)
    ratio = _log_ratio(image, np.asarray(behind, np.uint8))
    by_ratio = np.asarray(np.interp(ratio, _RATIO, _ODDS), np.float32)
    nothing = Segmentation(np.zeros((height, width), np.bool_), None, 0.0, ("no instrument found",))
    mask = instrument_region(_opened(by_ratio > 1), _GAP * longer, prompts)
    if prompts.tool is not None:
        mask |= prompts.tool
    if not mask.any() or mask.all():
        return nothing
    away = distance_to(mask) > max(_FAR * longer, 2.0)
    beyond = away if prompts.background is None else away | prompts.background
    near = _window(~beyond, _NEARBY)
    smooth = cv2.GaussianBlur(np.stack([np.log(image.mean(axis=2) + _DARK), ratio], axis=-1)[near], (0, 0), 1.0)
    guide = np.asarray(smooth, np.float32)
    inside = prompts.within(near)
    odds = None if silhouette is None else log_odds_beyond(signed_distance(silhouette))
    for _ in range(_CUTS):
        known = shaft_log_odds(mask) if odds is None else odds
        total = by_ratio if known is None else by_ratio + np.clip(known, -_LARGEST_PRIOR, _LARGEST_PRIOR)
        before, mask = mask, np.zeros_like(mask)
        mask[near] = cut(total[near], guide, background=beyond[near], tool=inside.tool, weight=_WEIGHT)
        mask = fill_holes(instrument_region(mask, _GAP * longer, prompts))
        if not mask.any() or mask.all():
            return nothing
        if odds is not None or (mask == before).all():
            break  # another cut would be of the same log-odds
    mask = fill_holes(_closed(mask, max(round(_CLOSING * longer), 1)))
    mask[near] = _at_edges(image[near], mask[near], guide)
    mask = fill_holes(mask)
    if prompts.background is not None:
        mask &= ~prompts.background
    if not mask.any() or mask.all():
        return nothing
    window = _window(mask, max(round(_WINDOW * longer), 2))
    colours = measure_colours(np.ascontiguousarray(image[window]))
    verdict = assess_mask(mask, window, by_ratio[window], colours, prompts=prompts)
    score = np.asarray(1 / (1 + np.exp(-total)), np.float32)
    return noted(Segmentation(mask, score, verdict.confidence, verdict.notes))


def _closest_values(stack: Image) -> tuple[Image, Float32]:
    """Return the values (h, w, 3) that images (N, h, w, 3) agree on most closely, and the spread (h, w) of most."""
    ordered = np.sort(stack, axis=0).astype(np.int16)
    count = max(round(_AGREEING * len(stack)), 3)
    widths = ordered[count - 1 :] - ordered[: len(stack) - count + 1]
    begin = widths.argmin(axis=0)
    values = np.take_along_axis(ordered, (begin + count // 2)[None], axis=0)[0]
    most = max(round(_STANDING[0] * len(stack)), count)
    spread = (ordered[most - 1 :] - ordered[: len(stack) - most + 1]).min(axis=0).max(axis=-1)
    return values.astype(np.uint8), spread.astype(np.float32)


def _free_of_instrument(image: Image, background: Image) -> Bool:
    """Return the pixels (h, w) that are far from what differs from the background, and from what that encloses."""
    odds = np.interp(_log_ratio(image, background), _RATIO, _ODDS)
    mask = instrument_region(_opened(odds > 0.5), _GAP * max(odds.shape), Prompts())
    if not mask.any():
        return np.ones(mask.shape, np.bool_)
    hull = np.zeros(mask.shape, np.uint8)
    v, u = np.nonzero(mask)
    cv2.fillConvexPoly(hull, cv2.convexHull(np.stack([u, v], axis=1).astype(np.int32)), 1)
    return np.asarray(distance_to(hull > 0) > _MARGIN * max(mask.shape))


def _median_of_free(stack: Image, free: Bool, otherwise: Image) -> Image:
    """Return the medians (h, w, 3) of images (N, h, w, 3) where they are ``free`` (N, h, w); a value of few is kept."""
    count = free.sum(axis=0)
    values = np.where(free[..., None], stack.astype(np.int16), 256)
    values.sort(axis=0)
    middle = np.take_along_axis(values, (np.maximum(count - 1, 0) // 2)[None, ..., None], axis=0)[0]
    return np.where((count >= _LEAST_FREE)[..., None], np.minimum(middle, 255), otherwise).astype(np.uint8)


def _at_edges(image: Image, mask: Bool, guide: Float32) -> Bool:
    """Move the outline of a mask (H, W), by at most a few pixels, to where the edges of the image are halfway."""
    return cut(
        edge_log_odds(image, mask),
        guide,
        background=distance_to(mask) > _EDGE,
        tool=distance_to(~mask) > _EDGE,
        weight=_WEIGHT,
    )


def _window(mask: Bool, margin: int) -> tuple[slice, slice]:
    """Return the rows and columns of a mask (H, W), which is not empty, with a margin, px, within the image."""
    left, top, across, down = window_around(mask, margin)
    return np.s_[top : top + down, left : left + across]


def _log_ratio(image: Image, background: Image) -> Float32:
    """Return the logarithm (H, W) of an image's brightness against the background's, in the channel that differs most.

    In a shadow all channels differ alike.
    """
    ratio = np.log((image.astype(np.float32) + _DARK) / (background.astype(np.float32) + _DARK))
    chosen = np.abs(ratio).argmax(axis=2)
    return np.asarray(np.take_along_axis(ratio, chosen[..., None], axis=2)[..., 0], np.float32)


def _most_frequent(values: NDArray[np.float64]) -> float:
    """Return the centre of the fullest bin of a histogram."""
    counts, edges = np.histogram(values, bins=40)
    fullest = int(counts.argmax())
    return float(edges[fullest : fullest + 2].mean())


def _blocks(rows: int) -> Iterator[slice]:
    return (slice(first, first + _ROWS) for first in range(0, rows, _ROWS))


def _opened(mask: Bool) -> Bool:
    """Remove what is thinner than three pixels."""
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0)


def _closed(mask: Bool, size: int) -> Bool:
    """Fill what is narrower than ``size`` px, also at the image's border."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    wide = cv2.copyMakeBorder(mask.astype(np.uint8), size, size, size, size, cv2.BORDER_REPLICATE)
    closed = cv2.morphologyEx(wide, cv2.MORPH_CLOSE, kernel)[size:-size, size:-size]
    return np.asarray(closed > 0)
