"""The mask of an instrument around a silhouette that is expected: the one cut of all masks of a known shape.

Each pixel has log-odds by its colour, by the edge between the local colours on both sides of the outline, and by the
silhouette: none near its outline, which may be off by as much as the pose is unsure, and more with the distance beyond.
The sides of a shaft are straight up to the image's border, which limits a rough mask in the dark corners of an image,
where cloth and tissue are as grey as the shaft. A minimum graph cut follows the edges of the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.evidence.shaft_edges import find_contour, find_shaft_edges
from dvrk_cmaes.geometry import Bool, Float32, Image
from dvrk_cmaes.segment.colours import Colours, ColourTable, brightest, local_colour_log_odds, measure_colours
from dvrk_cmaes.segment.confidence import assess_mask
from dvrk_cmaes.segment.graph_cut import cut, levels
from dvrk_cmaes.segment.prompts import Prompts
from dvrk_cmaes.segment.regions import FINEST, fill_holes, resized, shrunk, size_within
from dvrk_cmaes.segment.segmentation import Segmentation, nothing_found

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

_SIDES: Final = (2.5, 14.0)  # px, distances from the outline between which the means are taken
_NEARBY: Final = 8.0  # px, standard deviation of the Gaussian weights of the means
_COARSER: Final = 4  # by which the image is reduced for the means
_BLUR: Final = 1.0  # px, standard deviation of the Gaussian that smooths the image
_BRIGHTNESS: Final = 0.5  # weight of brightness against colour; below 1, as the tool casts shadows along its outline
_TEXTURE: Final = 6.0  # grey levels, difference of the two means at which the log-odds have half their weight
_EDGE_STEEPNESS: Final = 8.0  # difference of the log-odds between the background's and the instrument's mean colour
_FOCAL: Final = 1.2  # assumed focal length, in longer sides of the image; it matters little to find the sides
_RADIUS: Final = 0.004  # m, assumed radius of the shaft, likewise
_SLACK: Final = 1.5  # px on either side of a line, in which the log-odds are 0
_SHAFT_STEEPNESS: Final = 1.0  # log-odds per px beyond that
_LARGEST_OF_SHAFT: Final = 4.0  # bound of the log-odds


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
    prompts: Prompts,
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
    background, tool = prompts.background[window], prompts.tool[window]
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
            odds += _edge_log_odds(part, signed_distance(mask) if number else distance)
        if straight and (sides := _shaft_log_odds(mask, silhouette.shape, window)) is not None:
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
    finest: int = FINEST,
) -> Segmentation:
    """Segment an image (H, W, 3) uint8 BGR around a silhouette (H, W), as `mask_around`, and assess the mask.

    A ``rough`` silhouette is a mask that was found at a reduced size, and is a shaft's with straight sides: it is first
    refined, at half the size if the image is large. ``colours`` are of any size; without ``local`` they count alone.
    ``free`` is as there, of the size at which the mask is found, where the silhouette is not rough; that is at most
    ``finest`` px.
    """
    longest, expected = min(max(silhouette.shape), finest), silhouette
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


def _edge_log_odds(image: Image, away: Float32) -> Float32:
    """Return log-odds of instrument (H, W) by the local mean colours on both sides of a mask's outline.

    Lens and sensor blur every edge, so that the colour of a pixel on the edge is a mixture of the colours on its two
    sides; the edge is where the mixture has equal parts. Colour histograms cannot locate it, since mixed colours may be
    frequent on one of the sides.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    away
        (H, W), the signed distance from the outline, px, negative inside.

    Returns
    -------
    (H, W) float32
        Positive where a pixel's colour is nearer to the mean inside than to the mean outside; 0 far from the outline.
    """
    colours = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR)
    blue, green, red = (colours[..., k] for k in range(3))
    # differences of channels, and brightness: linear, so that a mixture of two colours lies on the line between them
    parts = np.stack([blue - red, green - red, green - blue, _BRIGHTNESS * (blue + green + red)], axis=-1) / np.sqrt(3)
    inside, outside = (_local_mean(parts, (side > _SIDES[0]) & (side < _SIDES[1])) for side in (-away, away))
    between = inside - outside
    square = np.einsum("ijk,ijk->ij", between, between)
    share = np.einsum("ijk,ijk->ij", parts - outside, between) / np.maximum(square, 1e-3)
    weight = square / (square + _TEXTURE**2)
    odds = _EDGE_STEEPNESS * weight * np.clip(share - 0.5, -0.5, 0.5)
    return np.asarray(np.where(np.abs(away) < _SIDES[1], odds, 0), np.float32)


def _local_mean(parts: Float32, where: Bool) -> Float32:
    """Return the Gaussian-weighted local mean (H, W, C) of an image (H, W, C) over a region (H, W); 0 far from it.

    It is smooth, and computed at a reduced size.
    """
    height, width = where.shape
    size = max(width // _COARSER, 1), max(height // _COARSER, 1)

    def smoothed(values: Float32) -> Float32:
        small = cv2.GaussianBlur(cv2.resize(values, size, interpolation=cv2.INTER_AREA), (0, 0), _NEARBY / _COARSER)
        return np.asarray(cv2.resize(small, (width, height)), np.float32)

    weight = where.astype(np.float32)
    return np.asarray(smoothed(parts * weight[..., None]) / np.maximum(smoothed(weight), 1e-6)[..., None], np.float32)


def _shaft_log_odds(part: Bool, shape: tuple[int, ...], window: tuple[slice, slice]) -> Float32 | None:
    """Return log-odds of instrument (h, w) by the shaft's sides in a mask, or None if no sides are found.

    ``part`` (h, w) is the mask in a window (rows, columns) of an image of a shape (H, W). The log-odds are 0 distally
    of the more proximal of the two sides' distal ends, where the wrist begins.
    """
    mask = np.zeros(shape, np.bool_)
    mask[window] = part
    height, width = mask.shape
    focal = _FOCAL * max(height, width)
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    pairs = find_shaft_edges(mask, find_contour(mask, camera), camera, _RADIUS)
    if isinstance(pairs, str):
        return None
    lines = pairs[0].planes @ np.linalg.inv(camera.matrix)
    lines /= np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    v, u = np.mgrid[window].astype(np.float32)
    first, second = (line[0] * u + line[1] * v + line[2] for line in lines)  # px, positive outside
    outside = np.maximum(first, second)
    pull = -_SHAFT_STEEPNESS * np.sign(outside) * np.maximum(np.abs(outside) - _SLACK, 0)
    ends = pairs[0].ends  # (2, 2, 2), px, of each side
    across = lines[0, :2] - lines[1, :2]  # of opposite normals
    along = np.array([-across[1], across[0]]) / np.linalg.norm(across)
    to_border = np.minimum(ends, [width - 1, height - 1] - ends).min(axis=2)
    starts, stops = np.take_along_axis(to_border, (ends @ along).argsort(axis=1), axis=1).min(axis=0)
    along = along if starts <= stops else -along  # from the border of the image
    on_shaft = along[0] * u + along[1] * v < (ends @ along).max(axis=1).min()
    return np.asarray(np.where(on_shaft, np.clip(pull, -_LARGEST_OF_SHAFT, _LARGEST_OF_SHAFT), 0), np.float32)


def _within(mask: Bool, near: Bool) -> Bool:
    """Keep the pieces of a mask that lie mostly ``near`` the silhouette; what hides a part of it divides it."""
    count, labels, measures, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    area = measures[:, cv2.CC_STAT_AREA]
    share = np.bincount(labels[near], minlength=count) / np.maximum(area, 1)
    kept = (share >= _LEAST_WITHIN) & (area >= min(_LEAST_PIECE, area[1:].max(initial=0)))
    kept[0] = False
    return np.asarray(kept[labels])
