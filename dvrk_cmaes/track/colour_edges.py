"""An image's colours as a term of the pose, by lines across the outline.

On each line, every place of the edge explains the colours on either side with some probability: those of the instrument
within, those of the surroundings without; and the change between them. The edge's distribution follows, and near its
mean the exact place, from the line's own colours on both sides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.frame_fit import LocalFit
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN, median
from dvrk_cmaes.geometry import Bool, Float32, Float64, Image, Indices, Posed
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.doubts import SUPPORTED, colours_without_outline, outline_without_edge, reasons
from dvrk_cmaes.pose.refine.gauss_newton import Steps, refine
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.pose.terms.outline_term import Derivatives, OutlineTerm
from dvrk_cmaes.pose.terms.readings_term import ReadingsTerm
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.silhouette.moving_points import MovingPoints
from dvrk_cmaes.track.histogram_ratio import REACH, ColourModel, EdgeModel, bins_of, changes_along
from dvrk_cmaes.track.outlines import MOST_CLEARANCE, DrawnOutline, OutlineModel

PARTS: Final = 2
"""Parts of the instrument whose colours are learned apart: the shaft, and what follows it."""

_NEAR = ((12.0, 2), (6.0, 1))
"""For each drawing of the outline, the farthest distance of an edge, px, and the steps that are taken."""
_FAR = ((48.0, 2), (48.0, 2), (24.0, 2), (24.0, 2), *_NEAR)
_CORRELATION_PX = 8.0  # of edge that counts as one measurement
_SIGMA_PX = 0.2  # standard deviation of an exact edge
_OUTLIER = 2.0  # standard deviations, scale of the robust weight
_SUPPORT_PX = 3.0  # distance within which an edge supports a point of the outline
_BESIDE = 3  # px from the outline, beyond which the instrument's colours tell that it is elsewhere
_FARTHEST = 12.0  # pixels of the image as it is sampled; to look farther, the image is reduced
_DEPENDENT = 0.3  # weight of a pixel's log-odds: neighbours are alike
_CHANGE_SCORE = 1.0 / _DEPENDENT  # weight of the log-odds of a change relative to those of a pixel
_LEAST_CLEARANCE = 3.0  # px within the instrument and beside it
_LEAST_ODDS = 0.4  # mean log-odds of the pixels on either side of an edge
# weight of the log-odds of a change relative to those means, and the least of their sum, from which on an edge counts
# where the outer side's colours do not discriminate, as in a shadow as dark as the shaft
_CHANGE_WEIGHT, _LEAST_CLEAR = 0.5, 1.0
_LARGEST_STD = 3.0  # px
_REFINEMENTS = 2  # of the exact place of an edge
_WINDOW = 1  # px on either side of an edge within which its exact place is found
_LEAST_CONTRAST = 24.0  # difference of the colours of the sides, for the exact place
_FINE_STD, _COARSE_STD = 0.8, 2.0  # px, of an edge's place where it is exact, and where it is not
_BLUR = 1.2  # px from the outline, within which pixels have colours of both sides


@dataclass(frozen=True, eq=False)
class EdgeAppearance:
    """Models of the colours and of the edges, of the same parts of the instrument."""

    colours: ColourModel
    edges: EdgeModel

    def mixed(self, other: EdgeAppearance, share: float) -> EdgeAppearance:
        """Return the appearance with a share of another one."""
        return EdgeAppearance(self.colours.mixed(other.colours, share), self.edges.mixed(other.edges, share))


def pixels_along(
    image: Image, at: Float64, normals: Float64, along: Float32, seen: Bool | None = None
) -> tuple[Image, Bool]:
    """Return the nearest pixels of an image (H, W, 3) on N lines, (N, K, 3), and whether they are in it, (N, K).

    ``at`` (N, 2) are points of the lines, ``normals`` (N, 2) their directions, ``along`` (K,) px the distances from
    those points. Pixels that are not ``seen`` (H, W) count as not in the image.
    """
    height, width = image.shape[:2]
    begin, direction = (at + 0.5).astype(np.float32), normals.astype(np.float32)
    u, v = (np.floor(begin[:, k, None] + direction[:, k, None] * along).astype(np.int32) for k in (0, 1))
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    index = v * width + u
    index[~inside] = 0
    if seen is not None:
        inside &= seen.ravel().take(index)
    return image.reshape(-1, 3).take(index, axis=0), inside


def _parts_of(outline: DrawnOutline) -> Indices:
    """Return the part of the instrument of each point (N,)."""
    return np.minimum(outline.link, PARTS - 1)


def _reduced(image: Image, ignore: Bool | None, scale: int) -> tuple[Image, Bool | None]:
    """Return an image reduced by a scale, (h, w, 3), and its pixels that have a say (h, w), None for all."""
    if scale == 1:
        return image, None if ignore is None else ~ignore
    size = (image.shape[1] // scale, image.shape[0] // scale)
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    if ignore is None:
        return small, None
    return small, cv2.resize(ignore.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0


class EdgeDistances(NamedTuple):
    """Distances (N,), px, by which outline points lie outside the edge that was found, and whether one was, (N,).

    ``variance`` (N,), px^2, is that of the edge's place beyond that of all edges.
    """

    distance: Float64
    found: Bool
    variance: Float64


class ImageEvidence:
    """The colours of an image (H, W, 3), BGR, given an appearance; ``ignore`` (H, W) are pixels without a say."""

    def __init__(self, image: Image, model: EdgeAppearance, ignore: Bool | None = None) -> None:
        self._image = np.ascontiguousarray(image)
        self._model = model
        self._ignore = ignore
        self._levels: dict[int, tuple[Image, Bool | None]] = {}

    def _level(self, scale: int) -> tuple[Image, Bool | None]:
        """Return the image reduced by a scale, and its pixels that have a say, as `_reduced`."""
        if scale not in self._levels:
            self._levels[scale] = _reduced(self._image, self._ignore, scale)
        return self._levels[scale]

    def distances(self, pixels: Float64, outline: DrawnOutline, reach: float) -> EdgeDistances:
        """Measure how far an outline's points, now at ``pixels`` (N, 2), lie outside the edge."""
        scale = 1
        while reach > _FARTHEST * scale:
            scale *= 2
        if scale == 1:
            return self._measured(pixels, outline, reach, scale)
        small = self._measured((pixels + 0.5) / scale - 0.5, outline, reach / scale, scale)
        return EdgeDistances(small.distance * scale, small.found, small.variance * scale**2)

    def _measured(self, pixels: Float64, outline: DrawnOutline, reach: float, scale: int) -> EdgeDistances:
        """Measure the distances in the image reduced by a scale, in its pixels."""
        count, (image, seen) = int(np.ceil(reach)), self._level(scale)
        clearance = np.minimum(outline.clearance / np.float32(scale), MOST_CLEARANCE)
        along = np.arange(-count - MOST_CLEARANCE, count + MOST_CLEARANCE + 1, dtype=np.float32)
        colours, valid = pixels_along(image, pixels, outline.normals, along, seen)
        odds = _odds_of(self._model.colours, bins_of(colours), outline, valid)
        total = np.zeros((len(pixels), odds.shape[1] + 1), np.float32)
        np.cumsum(odds, axis=1, out=total[:, 1:])
        # an edge at place k lies between samples k - 1 and k
        rows, place = np.arange(len(pixels))[:, None], np.arange(MOST_CLEARANCE, MOST_CLEARANCE + 2 * count + 1)
        inside, outside = (np.rint(side).astype(np.int32)[:, None] for side in clearance)
        at_edge = total[:, MOST_CLEARANCE : MOST_CLEARANCE + 2 * count + 1]
        within = at_edge - total[rows, place - inside]
        beside = total[rows, place + outside] - at_edge
        about = np.s_[:, MOST_CLEARANCE - REACH : MOST_CLEARANCE + 2 * count + REACH]
        change = _odds_of(self._model.edges, changes_along(colours[about]), outline, _both_seen(valid[about]))
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
        observed = (inner > _LEAST_ODDS) & ((outer < -_LEAST_ODDS) | clear)
        observed &= (best > 0) & (best < 2 * count) & (np.minimum(inside, outside) >= _LEAST_CLEARANCE)
        found = observed[:, 0] & (variance < _LARGEST_STD**2)
        mean, fine = _refined(image, pixels, outline.normals, mean)
        variance = np.where(fine, _FINE_STD**2, variance + _COARSE_STD**2)
        return EdgeDistances(np.where(found, -mean, 0.0).astype(np.float64), found, variance.astype(np.float64))

    def unexplained(self, pixels: Float64, outline: DrawnOutline) -> float:
        """Return the share of an outline beside which the instrument's colours go on; its points are at ``pixels``."""
        along = np.arange(_BESIDE, MOST_CLEARANCE + 1, dtype=np.float32)
        image, seen = self._level(1)
        colours, valid = pixels_along(image, pixels, outline.normals, along, seen)
        odds = _odds_of(self._model.colours, bins_of(colours), outline, valid)
        valid &= along <= outline.clearance[1][:, None] - 1
        count = valid.sum(axis=1)
        seen_well = count >= _LEAST_CLEARANCE
        like = seen_well & ((odds * valid).sum(axis=1) > _LEAST_ODDS * count)
        return float(outline.lengths[like].sum() / outline.lengths[seen_well].sum()) if seen_well.any() else 1.0


def _both_seen(valid: Bool) -> Bool:
    """Return whether both samples of a change are ``valid`` (N, K), as `changes_along` returns the changes."""
    return valid[:, 2 * REACH - 1 :] & valid[:, : 1 - 2 * REACH]


def _odds_of(model: ColourModel | EdgeModel, bins: NDArray[np.int32], outline: DrawnOutline, valid: Bool) -> Float32:
    """Return the log-odds (N, K) of bins (N, K) on the lines of an outline, by the part of the instrument.

    They are those of instrument, or of its outline; 0 where bins are not ``valid`` (N, K).
    """
    bins += (_parts_of(outline) * model.log_odds.shape[1]).astype(np.int32)[:, None]
    odds = np.asarray(model.log_odds.ravel().take(bins))
    odds *= valid
    return odds


def _refined(image: Image, pixels: Float64, normals: Float64, place: Float32) -> tuple[Float32, Bool]:
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


class ColourEdges(OutlineTerm[tuple[Float64, Float64, Float64]]):
    """The distances of outlines, drawn once, from the edges that the colours of images show: a sum of squares.

    Parameters
    ----------
    model
        Draws outlines, and moves their points.
    drawn
        The outlines, of different views.
    images
        The images, by index of the view.
    reach
        Farthest distance of an edge, px.
    covariance
        Covariance (D, D) of the pose, by which distances are expected that are not outliers.
    """

    views = ()

    def __init__(
        self,
        model: OutlineModel,
        drawn: Sequence[DrawnOutline],
        images: Mapping[int, ImageEvidence],
        reach: float,
        covariance: Float64,
    ) -> None:
        self._model, self._drawn, self._images, self._reach = model, drawn, images, reach
        self._covariance, self._lengths = covariance, np.concatenate([outline.lengths for outline in drawn])

    def draw(
        self, at: Posed, *, derivatives: Derivatives | None = "closed-form"
    ) -> list[tuple[Float64, Float64, Float64]]:
        """Measure the outlines' points at C poses: motion (N, D), distances (N,), px, and weights (N,) of each."""
        return [self._measured(at[k]) for k in range(len(at))]

    def cost_of(self, drawn: tuple[Float64, Float64, Float64]) -> float:
        """Return the sum of squares of the edges that were found, with their weights there."""
        _, distance, weights = drawn
        return float(weights @ distance**2)

    def near(self, drawn: Sequence[tuple[Float64, Float64, Float64]], at: Posed) -> Quadratic:
        """Return the approximation of half of it near C poses."""
        weighted = [(motion, distance, motion.T * weights) for motion, distance, weights in drawn]
        information, slope = zip(*((w @ motion, w @ distance) for motion, distance, w in weighted), strict=True)
        return Quadratic(np.array(information), np.array(slope))

    def fit(self, at: Posed) -> EdgeFit | None:
        """Measure how the images support a pose; None if it is behind the camera."""
        moving, lengths = self._moving(at), self._lengths
        if moving is None:
            return None
        edges, near = self._edges(moving), self.near(self.draw(at[None]), at[None])
        close = edges.found & (np.abs(edges.distance) < _SUPPORT_PX)
        pairs = zip(self._drawn, moving, strict=True)
        beside = [self._images[outline.view].unexplained(now.pixels, outline) for outline, now in pairs]
        sigma = NORMAL_MEDIAN * median(np.abs(edges.distance[close])) if close.any() else None
        supported = float(lengths[close].sum() / lengths.sum())
        information, slope = near.information[0], near.slope[0]
        return EdgeFit(at, information, slope, supported, float(np.mean(beside)), sigma)

    def _measured(self, at: Posed) -> tuple[Float64, Float64, Float64]:
        """Return the motion (N, D) of the outlines' points at a pose, their distances (N,), px, and weights (N,)."""
        moving, lengths = self._moving(at), self._lengths
        if moving is None:
            return np.zeros((len(lengths), len(self._covariance))), np.zeros(len(lengths)), np.zeros(len(lengths))
        edges, jacobian = self._edges(moving), np.concatenate([now.jacobian for now in moving])
        expected = np.einsum("ni,ij,nj->n", jacobian, self._covariance, jacobian)
        width = _OUTLIER**2 * (_SIGMA_PX**2 + np.minimum(expected, self._reach**2))
        weights = lengths * edges.found / (_SIGMA_PX**2 + edges.variance)
        weights /= _CORRELATION_PX * (1 + edges.distance**2 / width) ** 2
        return jacobian, edges.distance, weights

    def _moving(self, at: Posed) -> list[MovingPoints] | None:
        """Return the outlines' points at a pose; None if one of them is not in front of its camera."""
        moved = [self._model.move(outline, at) for outline in self._drawn]
        return None if any(now is None for now in moved) else [now for now in moved if now is not None]

    def _edges(self, moving: Sequence[MovingPoints]) -> EdgeDistances:
        """Measure the distances of all points in their views."""
        pairs = zip(self._drawn, moving, strict=True)
        parts = [self._images[outline.view].distances(now.pixels, outline, self._reach) for outline, now in pairs]
        return EdgeDistances(*map(np.concatenate, zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class EdgeFit(LocalFit):
    """The fit of a pose to the edges that the colours of images show.

    ``supported`` is the share of the outline near which there is an edge, ``unexplained`` the share next to which the
    instrument's colours go on; ``sigma`` px is the robust standard deviation of the supporting edges, None without any.
    ``by_masks`` (D, 7) is as of `FrameFit`.
    """

    supported: float
    unexplained: float
    sigma: float | None
    by_masks: Float64 | None = None

    def with_margin(self, along: Float64) -> EdgeFit:
        """Return the fit without what all edges tell wrongly together; ``along`` (D,) is the pose's change by that."""
        moved = self.information @ along
        share = moved / (1 + along @ moved)
        information = self.information - np.outer(share, moved)
        return replace(self, information=information, slope=self.slope - share * float(along @ self.slope))

    @property
    def net_support(self) -> float:
        """The share of the outline that has an edge, less that which is unexplained."""
        return self.supported - self.unexplained

    @property
    def holds(self) -> bool:
        """Whether the images support the pose at all."""
        least, most = SUPPORTED
        return self.supported >= least and self.unexplained <= most

    @property
    def doubts(self) -> list[str]:
        """The reasons, in words, for which the pose does not fit its images well."""
        return reasons(outline_without_edge(self.supported), colours_without_outline(self.unexplained))


def fit_edges(
    model: OutlineModel, images: Mapping[int, ImageEvidence], start: Posed, expected: Expected, *, far: bool
) -> EdgeFit | None:
    """Fit a pose to the edges that the colours of images show; None if it has no outline in them.

    The joints stay within their limits: jaws that have passed each other have the outline of open ones.

    Parameters
    ----------
    model, images
        As of `ColourEdges`.
    start
        Where the fit starts.
    expected
        What is expected of the pose, which holds it where the edges tell nothing.
    far
        Whether edges are looked for far from the start.
    """
    at, covariance = start, np.asarray(np.linalg.inv(expected.information))
    limits = ReadingsTerm(Readings.none(model.instrument))
    for reach, steps in _FAR if far else _NEAR:
        drawn = [outline for view in images if (outline := model.draw(at, view)) is not None]
        if not drawn:
            return None
        term = ColourEdges(model, drawn, images, reach, covariance)
        (fit,) = refine(term, (expected, limits), at[None], Steps(steps, tested="none"))
        at, covariance = fit.at, np.asarray(np.linalg.inv(fit.information))
    return term.fit(at)


def learned(image: Image, pixels: Float64, outline: DrawnOutline, ignore: Bool | None = None) -> EdgeAppearance:
    """Return what is seen along the lines of an outline whose points are at ``pixels`` (N, 2)."""
    along = np.arange(-MOST_CLEARANCE, MOST_CLEARANCE + 1, dtype=np.float32)
    seen = None if ignore is None else ~ignore
    colours, valid = pixels_along(np.ascontiguousarray(image), pixels, outline.normals, along, seen)
    parts = _parts_of(outline)
    within, beside = outline.clearance[:, :, None]

    def of_parts(bins: NDArray[np.int32], which: Bool) -> list[NDArray[np.int32]]:
        return [bins[which & (parts == part)[:, None]] for part in range(PARTS)]

    bins = bins_of(colours)
    inside = valid & (along < -_BLUR) & (along > _BLUR - within)
    outside = valid & (along > _BLUR) & (along < beside - _BLUR)
    at, changes, seen_both = along[REACH : 1 - REACH] - 0.5, changes_along(colours), _both_seen(valid)
    edge = seen_both & (np.abs(at) < 1)
    elsewhere = seen_both & (np.abs(at) > REACH + _BLUR) & (at > REACH - within) & (at < beside - REACH)
    return EdgeAppearance(
        ColourModel.learned(of_parts(bins, inside), bins[outside]),
        EdgeModel.learned(of_parts(changes, edge), changes[elsewhere]),
    )
