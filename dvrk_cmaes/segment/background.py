"""What a camera that stands still sees behind the instrument, and the log-odds of instrument by what differs from it.

The background of each pixel is the value that the images agree on most closely; images in which the instrument is near
the pixel are then left out. Images that are shifted by some pixels are registered first. Of a single image, it is a
smooth surface that fits most pixels, as of paper under a lamp.

A pixel belongs to the instrument if its brightness or colour is farther from the background's than noise and shadows
are. A pixel that is as the background is may still be the instrument's where that has the same colours, as a dark shaft
before the dark squares of a board; there the shape of the instrument decides.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Bool, Float32, Image
from dvrk_cmaes.segment.around import segmentation_around
from dvrk_cmaes.segment.colours import ColourTable, measure_colours
from dvrk_cmaes.segment.graph_cut import LARGEST
from dvrk_cmaes.segment.prompts import Prompts, no_prompts
from dvrk_cmaes.segment.regions import FINEST, SMALLEST, distance_to, instrument_region, resized, shrunk
from dvrk_cmaes.segment.segmentation import Segmentation, nothing_found

FEWEST: Final = 6
"""Images from which a background is learned, at least."""
MOST: Final = 24
"""Images from which a background is learned, at most."""

_AGREEING: Final = 0.3  # share of the images whose closest values show a pixel's background
_STANDING: Final = 0.6, 75.0, 7.0  # of share 0.6 of the images, 75 % of the pixels differ by at most 7 grey levels
_PASSES: Final = 2  # in which images with the instrument near a pixel are left out
_MARGIN: Final = 0.03  # of the longer side; shadows reach that far
_LEAST_FREE: Final = 3  # images without the instrument near a pixel
_ROWS: Final = 64  # that are worked on at once, to bound memory
_SHIFTED: Final = 0.006  # of the longer side, by which an image is shifted, at most
_REGISTERED: Final = 0.98  # of the differences before, above which a shift is not taken

_DARK: Final = 3.0  # grey levels added before logarithms, so that noise in the dark does not count
_RATIO: Final = np.array([-0.7, -0.5, -0.38, -0.28, -0.12, -0.06, 0.06, 0.12, 0.3])
_ODDS: Final = np.array([4.0, 3.0, 1.0, -0.3, -1.0, -4.0, -4.0, 0.0, 3.0])
"""Log-odds of instrument by the logarithm of brightness against the background's; shadows are about -0.25."""
_NOISE: Final = 2.0  # standard deviations of the differences, which say nothing
_LEVELS: Final = 9  # limits of the bins of brightness, in which the noise is measured
_LEAST_PIXELS: Final = 200  # in such a bin
_MOST_NOISE: Final = 2.0  # in such a bin, times that of the whole picture
_SAME: Final = 0.15, 4.0  # log-odds against a pixel that is as the background: where the instrument has its colour, not
_UNSEEN: Final = 0.05  # share of the instrument whose colours do not differ from the background anywhere
_SMOOTH: Final = 0.7  # px, standard deviation of the Gaussian that smooths differences
_FAINT: Final = 0.3  # logarithm of brightness against the background's, up to which a difference is faint
_NEARBY: Final = 1.5  # px, standard deviation of the Gaussian in which the mean and the spread of faint ones are taken
_SHARED_NOISE: Final = 0.5  # of the noise, which the mean of faint differences has
_MEANS: Final = np.array([-0.3, -0.2, -0.12, -0.06, 0.06, 0.12, 0.2])
_ODDS_OF_MEANS: Final = np.array([0.0, -0.3, -1.0, -4.0, -4.0, 0.0, 3.0])
_SPREADS, _ODDS_OF_SPREADS = np.array([0.05, 0.08, 0.14]), np.array([-4.0, 0.0, 3.0])
"""Log-odds of instrument by the mean, and by the standard deviation, of faint differences near a pixel."""
GAP: Final = 0.04
"""Of the longer side, between pieces of an instrument."""
_SURFACE: Final = 160  # px, longer side at which it is fitted
_SURFACE_PASSES: Final = 8
_NEAR_SURFACE: Final = 0.05  # logarithm of brightness
_LEAST_SURFACE: Final = 0.4  # share of the pixels that a smooth background fits


def learn_background(images: Sequence[Image]) -> Image | str:
    """Learn the background from images (H, W, 3) uint8 BGR of a camera that stands still.

    Returns it at a size of at most 1000 px, (h, w, 3); why there is none if the images are too few, of several sizes,
    or show no background that stands still, or nothing that moves before it.
    """
    if len(images) < FEWEST:
        return f"{len(images)} images, fewer than {FEWEST}"
    if len({image.shape for image in images}) > 1:
        return "the images are of several sizes"
    stack = np.stack([shrunk(image, FINEST) for image in images])
    usual = np.empty(stack.shape[1:], np.uint8)
    for rows in _blocks(stack.shape[1]):
        usual[rows] = np.sort(stack[:, rows], axis=0)[len(stack) // 2]
    for k, image in enumerate(stack):
        stack[k] = _shifted(image, *_shift(usual, image))
    found, spread = np.empty(stack.shape[1:], np.uint8), np.empty(stack.shape[1:3], np.float32)
    for rows in _blocks(stack.shape[1]):
        found[rows], spread[rows] = _closest_values(stack[:, rows])
    _, percentile, levels = _STANDING
    differ = float(np.percentile(spread, percentile))
    if differ > levels:
        return f"the images do not show the same scene: a quarter of the pixels differ by {differ:.0f} grey levels"
    for _ in range(_PASSES):
        free = np.stack([_free_of_instrument(image, found) for image in stack])
        if 2 * np.count_nonzero(free.all(axis=(1, 2))) > len(stack):
            return "the images are alike: nothing moves before the camera"
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
    near = np.abs(brightness - np.median(brightness)) < 6 * _NEAR_SURFACE
    for _ in range(_SURFACE_PASSES):
        if near.mean() < _LEAST_SURFACE / 2:
            return None
        weights = np.linalg.lstsq(terms[near], values[near], rcond=None)[0]
        near = np.abs(values - terms @ weights).max(axis=1) < _NEAR_SURFACE
    if near.mean() < _LEAST_SURFACE:
        return None
    surface = np.exp(terms @ weights).reshape(height, width, 3) - _DARK
    return np.asarray(np.clip(surface + 0.5, 0, 255), np.uint8)


def foreground_log_odds(image: Image, background: Image) -> Float32:
    """Return log-odds of instrument (h, w) by what differs from a background (of any size), at most 1000 px wide.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    background
        (h, w, 3), of any size. It is registered with the image.
    """
    small = shrunk(image, FINEST)
    behind = np.asarray(cv2.resize(background, small.shape[1::-1], interpolation=cv2.INTER_LINEAR), np.uint8)
    along, down = _shift(behind, small)
    ratios = _ratios(small, _shifted(behind, -along, -down))
    odds = _by_difference(*ratios)
    differs = differing_region(odds)
    if not differs.any() or differs.all():
        return odds
    likely = ColourTable(measure_colours(small)).log_odds(differs, odds < -1, unseen=_UNSEEN)
    odds = np.where(odds < 0, np.maximum(odds, np.clip(likely, -_SAME[1], -_SAME[0])), odds)
    return np.maximum(odds, _by_details(*ratios) + np.minimum(likely, 0))


def segment_before(image: Image, odds: Float32, prompts: Prompts) -> Segmentation:
    """Segment what differs from a background in an image (H, W, 3) uint8 BGR.

    ``odds`` (h, w) are `foreground_log_odds`, ``prompts`` those in pixels of the image.
    """
    height, width = image.shape[:2]
    small = prompts.resized(odds.shape[1], odds.shape[0], odds.shape[1] / width)
    around = resized(differing_region(odds, small), (width, height))
    if not around.any() or around.all():
        return nothing_found(image.shape)
    return segmentation_around(image, around, prompts, rough=True, colours=odds, local=False)


def differing_share(mask: Bool, odds: Float32) -> float:
    """Return the share of a mask (H, W) that clearly differs from a background, by log-odds (h, w); 0 if empty."""
    small = resized(mask, odds.shape[1::-1])
    return float((odds[small] > 1).mean()) if small.any() else 0.0


def differing_region(odds: Float32, prompts: Prompts | None = None) -> Bool:
    """Return the pixels (h, w) that most likely are the instrument, by log-odds (h, w) against a background."""
    prompts = no_prompts(odds.shape) if prompts is None else prompts
    return instrument_region(_opened(odds > 1), GAP * max(odds.shape), prompts) | prompts.tool


def _ratios(image: Image, background: Image) -> tuple[Float32, Float32]:
    """Return logarithms of an image's brightness against a background of the same size, (h, w, 3), and their noise."""
    kernel = np.ones((3, 3), np.uint8)
    near = np.clip(image, cv2.erode(background, kernel), cv2.dilate(background, kernel))
    ratio = np.log((image.astype(np.float32) + _DARK) / (near.astype(np.float32) + _DARK))
    return ratio, _noise(image, background)[near] / (near + _DARK)


def _by_difference(ratio: Float32, noise: Float32) -> Float32:
    """Return log-odds of instrument (h, w) by `_ratios`."""
    most = np.abs(ratio).argmax(axis=2)[..., None]  # in a shadow all channels differ alike
    ratio, noise = (np.take_along_axis(each, most, axis=2)[..., 0] for each in (ratio, noise))
    beyond = np.sign(ratio) * np.maximum(np.abs(ratio) - _NOISE * noise, 0)
    smooth = cv2.GaussianBlur(beyond.astype(np.float32), (0, 0), _SMOOTH)
    return np.asarray(np.interp(smooth, _RATIO, _ODDS), np.float32)


def _by_details(ratio: Float32, noise: Float32) -> Float32:
    """Return log-odds of instrument (h, w) by the mean and the spread of faint differences near each pixel.

    ``ratio`` and ``noise`` are `_ratios`. What is as dark as its background has other details; a shadow has the same.
    """
    ratio, noise = ratio.mean(axis=2), noise.mean(axis=2)
    faint = np.abs(ratio) < _FAINT
    count, mean, square = (
        cv2.GaussianBlur(np.where(faint, each, 0).astype(np.float32), (0, 0), _NEARBY)
        for each in (np.ones_like(ratio), ratio, ratio**2)
    )
    mean, square = mean / np.maximum(count, 0.05), square / np.maximum(count, 0.05)
    spread = np.sqrt(np.maximum(square - mean**2 - _NOISE * noise**2, 0))
    beyond = np.sign(mean) * np.maximum(np.abs(mean) - _SHARED_NOISE * noise, 0)
    by_mean, by_spread = np.interp(beyond, _MEANS, _ODDS_OF_MEANS), np.interp(spread, _SPREADS, _ODDS_OF_SPREADS)
    return np.where(faint, np.maximum(by_mean, by_spread), -LARGEST).astype(np.float32)


def _noise(image: Image, background: Image) -> Float32:
    """Return the standard deviation of an image's noise by brightness (256,), grey levels, by its difference.

    It is at most twice that of the whole picture: of a dark corner, the instrument may cover most pixels.
    """
    away = np.abs(image.astype(np.float32) - background).mean(axis=2)
    level = background.mean(axis=2)
    limits = np.linspace(0, 256, _LEVELS)
    bins = [(level >= low) & (level < high) for low, high in itertools.pairwise(limits)]
    known = [k for k, each in enumerate(bins) if each.sum() > _LEAST_PIXELS]
    if not known:
        return np.ones(256, np.float32)
    most = _MOST_NOISE * float(np.median(away))
    deviations = [1.48 * min(float(np.median(away[bins[k]])), most) for k in known]
    middles = (limits[:-1] + limits[1:])[known] / 2
    return np.maximum(np.interp(np.arange(256), middles, deviations), 1.0).astype(np.float32)


def _shift(background: Image, image: Image) -> tuple[float, float]:
    """Return by how much an image (h, w, 3) is shifted to the right and down against a background, px; 0 if unclear."""
    first, second = (cv2.GaussianBlur(each.mean(axis=2, dtype=np.float32), (0, 0), 1.0) for each in (background, image))
    window = cv2.createHanningWindow(first.shape[::-1], cv2.CV_32F)
    (along, down), _ = cv2.phaseCorrelate(first, second, window)
    if max(abs(along), abs(down)) > _SHIFTED * max(first.shape):
        return 0.0, 0.0
    before, after = (
        float(np.percentile(np.abs(each - second), 75)) for each in (first, _shifted(first, -along, -down))
    )
    return (along, down) if after < _REGISTERED * before else (0.0, 0.0)


def _shifted(image: NDArray[Any], along: float, down: float) -> Any:
    """Return an image of which what is at ``along``, ``down`` px is at the origin."""
    if along == down == 0:
        return image
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    move = np.array([[1, 0, along], [0, 1, down]], np.float32)
    return cv2.warpAffine(image, move, image.shape[1::-1], flags=how, borderMode=cv2.BORDER_REPLICATE)


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
    mask = differing_region(_by_difference(*_ratios(image, background)))
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


def _blocks(rows: int) -> Iterator[slice]:
    return (slice(first, first + _ROWS) for first in range(0, rows, _ROWS))


def _opened(mask: Bool) -> Bool:
    """Remove what is thinner than three pixels."""
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0)
