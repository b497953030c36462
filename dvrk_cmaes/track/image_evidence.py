"""An image's colours as evidence about the outline, by lines across it.

On each line, every place of the edge explains the colours on either side with some probability: those of the instrument
within, those of the surroundings without; and the change between them. The edge's distribution follows, and near its
mean the exact place, from the line's own colours on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.silhouette.sliced_call import worked
from dvrk_cmaes.track.appearance import Appearance
from dvrk_cmaes.track.clearance import MOST_CLEARANCE
from dvrk_cmaes.track.colour_model import ColourModel, bins_of
from dvrk_cmaes.track.drawn_outline import DrawnOutline
from dvrk_cmaes.track.edge_model import REACH, EdgeModel, changes_along
from dvrk_cmaes.track.edges import EdgeDistances, Pass
from dvrk_cmaes.track.image_lines import pixels_along

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]

PARTS: Final = 2
"""Parts of the instrument whose colours are learned apart: the shaft, and what follows it."""

_PASSES = ((1.0, 2), (0.5, 1))  # for each drawing, farthest distance as a share of the largest, and steps
_WIDER = ((4.0, 2), (4.0, 2), (2.0, 2), (2.0, 2))  # the same before these, in a search around the prediction
_FARTHEST = 12.0  # pixels of the image as it is sampled; to look farther, the image is reduced
_DEPENDENT = 0.3  # weight of a pixel's log-odds: neighbours are alike
_CHANGE_SCORE = 1.0 / _DEPENDENT  # weight of the log-odds of a change relative to those of a pixel
_LEAST_CLEARANCE = 3.0  # px within the instrument and beside it
_LEAST_ODDS = 0.4  # mean log-odds of the pixels on either side of an edge
_CHANGE_WEIGHT = 0.5  # of the log-odds of a change beside those means, and the least of their sum, by which an edge
_LEAST_CLEAR = 1.0  # is told where the outer side's colours do not tell, as in a shadow that is as dark as the shaft
_LARGEST_STD = 3.0  # px
_REFINEMENTS = 2  # of the exact place of an edge
_WINDOW = 1  # px on either side of an edge within which its exact place is found
_LEAST_CONTRAST = 24.0  # difference of the colours of the sides, for the exact place
_FINE_STD, _COARSE_STD = 0.8, 2.0  # px, of an edge's place where it is exact, and where it is not
_BLUR = 1.2  # px from the outline, within which pixels have colours of both sides
_WORK = 450  # pixel rows of silhouettes that take as long as the correction by the distances of an outline
_BESIDE = 3  # px from the outline, beyond which the instrument's colours tell that it is elsewhere


def _parts_of(outline: DrawnOutline) -> NDArray[np.intp]:
    """Return the part of the instrument of each point (N,)."""
    return np.minimum(outline.link, PARTS - 1)


@dataclass(frozen=True, eq=False)
class _Level:
    """An image (h, w, 3) at a reduced size, and its pixels that have a say (h, w), None for all."""

    image: NDArray[np.uint8]
    seen: Bool | None

    @staticmethod
    def of(image: NDArray[np.uint8], ignore: Bool | None, scale: int) -> _Level:
        """Reduce an image by a scale."""
        if scale == 1:
            return _Level(image, None if ignore is None else ~ignore)
        size = (image.shape[1] // scale, image.shape[0] // scale)
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        if ignore is None:
            return _Level(small, None)
        there = cv2.resize(ignore.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        return _Level(small, there == 0)


class ImageEvidence:
    """The colours of an image (H, W, 3), BGR, given an appearance; ``ignore`` (H, W) are pixels without a say."""

    def __init__(
        self, image: NDArray[np.uint8], model: Appearance, ignore: Bool | None = None, *, wide: bool = False
    ) -> None:
        self._image = np.ascontiguousarray(image)
        self._model = model
        self._ignore = ignore
        self._wide = wide
        self._levels: dict[int, _Level] = {}

    def passes(self, config: TrackConfig) -> tuple[Pass, ...]:
        """Return passes with ever smaller distances."""
        passes = (*_WIDER, *_PASSES) if self._wide else _PASSES
        return tuple(Pass(share * config.reach_px, steps) for share, steps in passes)

    def wider(self) -> ImageEvidence:
        """Return the evidence that begins with edges far away, in the image reduced to a quarter, then to a half."""
        return ImageEvidence(self._image, self._model, self._ignore, wide=True)

    def _level(self, scale: int) -> _Level:
        """Return the image reduced by a scale."""
        if scale not in self._levels:
            self._levels[scale] = _Level.of(self._image, self._ignore, scale)
        return self._levels[scale]

    def distances(self, pixels: Float64, outline: DrawnOutline, reach: float) -> EdgeDistances:
        """Measure how far an outline's points, now at ``pixels`` (N, 2), lie outside the edge."""
        worked(_WORK, drawn=False)
        scale = 1
        while reach > _FARTHEST * scale:
            scale *= 2
        if scale == 1:
            return self._measured(pixels, outline, reach, scale)
        small = self._measured((pixels + 0.5) / scale - 0.5, outline, reach / scale, scale)
        return EdgeDistances(small.distance * scale, small.found, small.variance * scale**2)

    def _measured(self, pixels: Float64, outline: DrawnOutline, reach: float, scale: int) -> EdgeDistances:
        """Measure the distances in the image reduced by a scale, in its pixels."""
        count, clearance, level = int(np.ceil(reach)), outline.clearance.at_scale(scale), self._level(scale)
        along = np.arange(-count - MOST_CLEARANCE, count + MOST_CLEARANCE + 1, dtype=np.float32)
        colours, valid = pixels_along(level.image, pixels, outline.normals, along, level.seen)
        odds = self._odds(colours, valid, outline)
        total = np.zeros((len(pixels), odds.shape[1] + 1), np.float32)
        np.cumsum(odds, axis=1, out=total[:, 1:])
        # an edge at place k lies between samples k - 1 and k
        rows, place = np.arange(len(pixels))[:, None], np.arange(MOST_CLEARANCE, MOST_CLEARANCE + 2 * count + 1)
        inside, outside = (np.rint(side).astype(np.int32)[:, None] for side in (clearance.inside, clearance.outside))
        at_edge = total[:, MOST_CLEARANCE : MOST_CLEARANCE + 2 * count + 1]
        within = at_edge - total[rows, place - inside]
        beside = total[rows, place + outside] - at_edge
        about = np.s_[:, MOST_CLEARANCE - REACH : MOST_CLEARANCE + 2 * count + REACH]
        change = self._edge_odds(colours[about], valid[about], outline)
        score = within - beside + _CHANGE_SCORE * change
        best = score.argmax(axis=1)[:, None]
        chance = np.exp(_DEPENDENT * (score - np.take_along_axis(score, best, axis=1)))
        chance /= chance.sum(axis=1, keepdims=True)
        at = np.arange(-count, count + 1, dtype=np.float32) - 0.5
        mean = chance @ at
        variance = np.maximum(chance @ at**2 - mean**2, 0)
        inner, outer, changed = (np.take_along_axis(values, best, axis=1) for values in (within, beside, change))
        inner, outer = inner / np.maximum(inside, 1), outer / np.maximum(outside, 1)
        clear = (inner - outer) / 2 + _CHANGE_WEIGHT * changed > _LEAST_CLEAR
        told = (inner > _LEAST_ODDS) & ((outer < -_LEAST_ODDS) | clear)
        told &= (best > 0) & (best < 2 * count) & (np.minimum(inside, outside) >= _LEAST_CLEARANCE)
        found = told[:, 0] & (variance < _LARGEST_STD**2)
        mean, fine = _refined(level.image, pixels, outline.normals, mean)
        variance = np.where(fine, _FINE_STD**2, variance + _COARSE_STD**2)
        return EdgeDistances(np.where(found, -mean, 0.0).astype(np.float64), found, variance.astype(np.float64))

    def unexplained(self, pixels: Float64, outline: DrawnOutline, reach: int) -> float:
        """Return the share of the outline beside which there are the instrument's colours."""
        along = np.arange(_BESIDE, MOST_CLEARANCE + 1, dtype=np.float32)
        level = self._level(1)
        colours, valid = pixels_along(level.image, pixels, outline.normals, along, level.seen)
        odds = self._odds(colours, valid, outline)
        valid &= along <= outline.clearance.outside[:, None] - 1
        count = valid.sum(axis=1)
        told = count >= _LEAST_CLEARANCE
        like = told & ((odds * valid).sum(axis=1) > _LEAST_ODDS * count)
        return float(outline.lengths[like].sum() / outline.lengths[told].sum()) if told.any() else 1.0

    def _odds(self, colours: NDArray[np.uint8], valid: Bool, outline: DrawnOutline) -> Float32:
        """Return the log-odds of instrument (N, K) of colours (N, K, 3) on lines, 0 where they are not ``valid``."""
        odds = _odds_of(self._model.colours, bins_of(colours), outline)
        odds *= valid
        return odds

    def _edge_odds(self, colours: NDArray[np.uint8], valid: Bool, outline: DrawnOutline) -> Float32:
        """Return the log-odds of the outline (N, K + 1 - 2 `REACH`) of the changes along lines of colours (N, K, 3)."""
        odds = _odds_of(self._model.edges, changes_along(colours), outline)
        odds *= _both_seen(valid)
        return odds


def _both_seen(valid: Bool) -> Bool:
    """Return whether both samples of a change are ``valid`` (N, K), as `changes_along` returns the changes."""
    return valid[:, 2 * REACH - 1 :] & valid[:, : 1 - 2 * REACH]


def _odds_of(model: ColourModel | EdgeModel, bins: NDArray[np.int32], outline: DrawnOutline) -> Float32:
    """Return the log-odds (N, K) of bins (N, K) on the lines of an outline, by the part of the instrument."""
    bins += (_parts_of(outline) * model.bins).astype(np.int32)[:, None]
    return np.asarray(model.log_odds.ravel().take(bins))


def _refined(image: NDArray[np.uint8], pixels: Float64, normals: Float64, place: Float32) -> tuple[Float32, Bool]:
    """Find the exact places of edges (N,) on lines in an image, and whether that is possible, (N,).

    The colour of a pixel at the edge is mixed of those on both sides in proportion to its parts.
    """
    at, direction = pixels.astype(np.float32), normals.astype(np.float32)
    along = np.arange(-_WINDOW - 1, _WINDOW + 2, dtype=np.float32)
    fine = np.ones(len(place), np.bool_)
    for _ in range(_REFINEMENTS):
        u, v = (at[:, k, None] + direction[:, k, None] * (place[:, None] + along) for k in (0, 1))
        values = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
        outer = values[:, -1]
        change = values[:, 0] - outer
        contrast = np.einsum("nc,nc->n", change, change)
        share = np.einsum("nkc,nc->nk", values[:, 1:-1] - outer[:, None], change)
        share = np.clip(share / np.maximum(contrast, 1.0)[:, None], 0.0, 1.0)
        fine &= contrast > _LEAST_CONTRAST**2
        place = np.where(fine, place + share.sum(axis=1) - (_WINDOW + 0.5), place)
    return place, fine


def learned(image: NDArray[np.uint8], pixels: Float64, outline: DrawnOutline, ignore: Bool | None = None) -> Appearance:
    """Return what is seen along the lines of an outline whose points are at ``pixels`` (N, 2)."""
    along = np.arange(-MOST_CLEARANCE, MOST_CLEARANCE + 1, dtype=np.float32)
    seen = None if ignore is None else ~ignore
    colours, valid = pixels_along(np.ascontiguousarray(image), pixels, outline.normals, along, seen)
    parts = _parts_of(outline)
    within, beside = outline.clearance.inside[:, None], outline.clearance.outside[:, None]

    def of_parts(bins: NDArray[np.int32], which: Bool) -> list[NDArray[np.int32]]:
        return [bins[which & (parts == part)[:, None]] for part in range(PARTS)]

    bins = bins_of(colours)
    inside = valid & (along < -_BLUR) & (along > _BLUR - within)
    outside = valid & (along > _BLUR) & (along < beside - _BLUR)
    at, changes, seen_both = along[REACH : 1 - REACH] - 0.5, changes_along(colours), _both_seen(valid)
    edge = seen_both & (np.abs(at) < 1)
    elsewhere = seen_both & (np.abs(at) > REACH + _BLUR) & (at > REACH - within) & (at < beside - REACH)
    return Appearance(
        ColourModel.learned(of_parts(bins, inside), bins[outside]),
        EdgeModel.learned(of_parts(changes, edge), changes[elsewhere]),
    )
