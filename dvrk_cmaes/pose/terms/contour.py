"""The contour of rough masks as a term, whose errors are correlated: generalised least squares.

The contour errors of a segmentation can have a standard deviation of a pixel or more and a correlation length of about
twenty pixels. The errors of neighbouring points are then nearly equal: their mean carries little information, while
their differences, such as the position of a bend or the direction of an edge, carry much. Generalised least squares
(Aitken) weights both correctly: for errors e (N,) with covariance C (N, N), the sum of squares is e^T C^-1 e / f with
f = ``_INFLATION``. For points at a distance of d px, C = s^2 (0.95 exp(-pi (d / 21)^2) + 0.05 * 21 I), plus the
variance of the quantisation to pixels. The uncorrelated part represents errors that are not smooth; per px of outline
its variance is about that of the whole error. Points with errors above ``_CLIP`` standard deviations are outliers of
the segmentation and left out.

Which points count, and s, are found anew at each pose, so sums of squares at different poses are not to be compared:
this term is for steps that are not tested, from poses that are accurate to about a millimetre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.evidence.outline_noise import OutlineNoise, sampled
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN, median
from dvrk_cmaes.geometry import Bool, Float64, Indices, Posed
from dvrk_cmaes.pose.terms.outline_term import OutlineTerm
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.silhouette import OutlinePoints

_LEAST_SIGMA = 0.6  # px; for more accurate contours the loss on the coverage gives smaller errors
_LARGEST_LENGTH = 25.0  # px; longer correlation is caused by errors of the instrument's shape
_LENGTH = 21.0  # px, correlation length
_CORRELATED = 0.95  # share of the variance
_CLIP = 2.5  # standard deviations
_REACH = 8  # px from the outline in which the mask's contour is searched
_LEAST_POINTS = 40  # outline points that need a contour point within reach for a view to count
_GRID = 1 / 12  # px^2, variance of the quantisation to pixels
_INFLATION = 2.0  # factor on the variances, because the errors of fits are larger than the covariance predicts
_FARTHEST = 40.0  # px, between points whose errors are correlated


def is_rough(noise: OutlineNoise) -> bool:
    """Return whether the errors of a mask's contour are a segmentation's, not those of the quantisation to pixels."""
    return noise.sigma > _LEAST_SIGMA


def has_correlated_noise(noise: OutlineNoise) -> bool:
    """Return whether the noise of a mask's contour is of the kind that `CorrelatedContour` models."""
    return is_rough(noise) and noise.length < _LARGEST_LENGTH


@dataclass(frozen=True, eq=False)
class DrawnContour:
    """The errors of a mask's contour along the outline of a pose, and what follows from their covariance.

    ``information`` (D, D) and ``slope`` (D,) are those of half the sum of squares, ``cost``; all are zero where too
    little contour is within reach.
    """

    information: Float64
    slope: Float64
    cost: float


class CorrelatedContour(OutlineTerm[DrawnContour]):
    """Distances of the masks' contours from the outline, of the ``views`` at their whole size.

    ``reach``, px, is the distance from the outline in which the contour is searched.
    """

    def __init__(self, views: Sequence[SizedView], *, reach: int = _REACH) -> None:
        self.views = tuple(views)
        self._reach = reach

    def draw(self, at: Posed, *, derivatives: bool = True) -> list[DrawnContour]:
        """Draw C poses, and sum up the views."""
        return [self._summed(self.of_views(at[k])) for k in range(len(at))]

    def of_views(self, at: Posed) -> list[DrawnContour]:
        """Draw one pose in each view."""
        return [_of_view(view, at, self._reach) for view in self.views]

    @staticmethod
    def _summed(of_views: Sequence[DrawnContour]) -> DrawnContour:
        """Return the sum of the views."""
        information, slope = (np.sum([getattr(d, name) for d in of_views], axis=0) for name in ("information", "slope"))
        return DrawnContour(information, slope, sum(drawn.cost for drawn in of_views))

    def cost_of(self, drawn: DrawnContour) -> float:
        """Return the sum of squares of what was drawn."""
        return drawn.cost

    def near(self, drawn: Sequence[DrawnContour], at: Posed) -> Quadratic:
        """Return the approximation of half the sum of squares near C poses."""
        return Quadratic(np.stack([d.information for d in drawn]), np.stack([d.slope for d in drawn]))


def _of_view(view: SizedView, at: Posed, reach: int) -> DrawnContour:
    """Compare the outline of one pose with the contour of one view."""
    (outline,) = view.outlines(Posed.stacked([at]))
    (jacobian,) = view.jacobians([outline], Posed.stacked([at]))
    error, lengths = _contour_distances(view.mask, outline, reach)
    known = np.isfinite(error) & (sampled(view.weight, outline.pixels) > 0.5)
    if known.sum() < _LEAST_POINTS:
        count = 6 + len(at.joints)
        return DrawnContour(np.zeros((count, count)), np.zeros(count), 0.0)
    sigma = max(NORMAL_MEDIAN * median(np.abs(error[known])), 0.5)
    index = np.flatnonzero(known & (np.abs(error) < _CLIP * sigma))
    error, lengths, pixels = error[index], lengths[index], outline.pixels[index]
    jacobian = jacobian[index] / lengths[:, None]
    variance = max(float(np.mean(error**2)) - _GRID / 2, 0.02)
    uncorrelated = variance * (1 - _CORRELATED) * _LENGTH + _GRID / lengths**2
    solved = solve_correlated(pixels, variance * _CORRELATED, uncorrelated, np.c_[jacobian, error])
    information, slope = jacobian.T @ solved[:, :-1] / _INFLATION, -jacobian.T @ solved[:, -1] / _INFLATION
    return DrawnContour(information, slope, float(error @ solved[:, -1]) / _INFLATION)


def solve_correlated(pixels: Float64, variance: float, uncorrelated: Float64, right: Float64) -> Float64:
    """Solve C x = ``right`` (N, K) for points ``pixels`` (N, 2) px whose errors have the covariance C of this module.

    ``variance`` is that of the correlated part, ``uncorrelated`` (N,) those of the rest, px^2. The outline is cut
    across its longest extent into pieces of ``_FARTHEST`` px; correlations between pieces that do not touch, all below
    2e-5, count as zero. C is then block tridiagonal, and the cost linear in the number of points. (SciPy solves such
    systems, too, but takes 0.2 s to import.)
    """
    spread = pixels - pixels.mean(axis=0)
    along = spread @ np.linalg.eigh(spread.T @ spread)[1][:, -1]
    order = np.argsort(along, kind="stable")
    piece = np.floor((along[order] - along[order[0]]) / _FARTHEST)
    pieces = np.split(order, np.flatnonzero(np.diff(piece)) + 1)

    def covariance(first: Indices, second: Indices) -> Float64:
        apart = pixels[first, None] - pixels[second]
        return np.asarray(variance * np.exp(-np.pi / _LENGTH**2 * (apart[..., 0] ** 2 + apart[..., 1] ** 2)))

    # Block elimination: of each piece, what it adds to the next one, then backwards the solution.
    reduced: list[tuple[Float64, Float64]] = []
    from_before = np.zeros((len(pieces[0]), 0))
    for points, following in zip(pieces, [*pieces[1:], order[:0]], strict=True):
        block, rest = covariance(points, points), right[points]
        block[np.diag_indices(len(points))] += uncorrelated[points]
        if reduced:
            block, rest = block - from_before @ reduced[-1][0], rest - from_before @ reduced[-1][1]
        coupling = covariance(points, following)
        both = np.linalg.solve(block, np.concatenate([coupling, rest], axis=1))
        reduced.append((both[:, : len(following)], both[:, len(following) :]))
        from_before = coupling.T
    solved = np.empty_like(right)
    following = order[:0]
    for points, (to_following, alone) in zip(reversed(pieces), reversed(reduced), strict=True):
        solved[points] = alone - to_following @ solved[following]
        following = points
    return solved


def _contour_distances(mask: Bool, outline: OutlinePoints, reach: int) -> tuple[Float64, Float64]:
    """Measure the distance from each outline point to the mask's contour along the normal, px, (N,).

    It is positive if the contour is outside the outline, and NaN if there is none within reach. The contour is searched
    along the row, or along the column where the outline is flat. Also returns the length of outline that each point
    represents, px, (N,).
    """
    lengths = np.linalg.norm(outline.normals, axis=1)
    flat = np.abs(outline.normals[:, 0]) < np.abs(outline.normals[:, 1])
    error = np.full(len(lengths), np.nan)
    for vertical in (False, True):
        index = np.flatnonzero(flat == vertical)
        edges = np.diff((mask.T if vertical else mask).astype(np.int8), axis=1)
        along, across = outline.pixels[index].T[:: -1 if vertical else 1]
        outwards = np.sign(outline.normals[index, int(vertical)])
        row = np.clip(np.rint(across).astype(int), 0, len(edges) - 1)
        column = np.floor(along).astype(int)[:, None] + np.arange(-reach, reach + 1)
        inside = (column >= 0) & (column < edges.shape[1])
        is_edge = edges[row[:, None], np.clip(column, 0, edges.shape[1] - 1)] == -outwards[:, None]
        off = np.where(inside & is_edge, column + 0.5 - along[:, None], np.inf)
        nearest = off[np.arange(len(index)), np.abs(off).argmin(axis=1)]
        error[index] = np.where(np.isfinite(nearest), nearest * outwards, np.nan)
    return error / lengths, lengths
