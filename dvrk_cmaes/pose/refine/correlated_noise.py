"""Last refinement on masks whose contour errors are correlated, by generalised least squares.

The contour errors of a segmentation can have a standard deviation of a pixel or more and a correlation length of about
twenty pixels. The errors of neighbouring points are then nearly equal: their mean carries little information, while
their differences, such as the position of a bend or the direction of an edge, carry much. Generalised least squares
(Aitken) weights both correctly. For errors e (N,) with covariance C (N, N) and Jacobian J (N, D), the step x solves

    (J^T C^-1 J / f + P) x = J^T C^-1 e / f - p,

where P and p come from the priors and f = ``_INFLATION``. For points at a distance of d px,
C = s^2 (0.95 exp(-pi (d / 21)^2) + 0.05 * 21 I), plus the variance of the quantisation to pixels. The uncorrelated part
represents errors that are not smooth; per px of outline its variance is about that of the whole error. Points with
errors above ``_CLIP`` standard deviations are outliers of the segmentation and left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.outline_noise import OutlineNoise, sampled
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.pose.refine.outline import OutlineRefiner
from dvrk_cmaes.silhouette import OutlinePoints

Float64 = NDArray[np.float64]

_LEAST_SIGMA = 0.6  # px; for more accurate contours the loss on the coverage gives smaller errors
_LARGEST_LENGTH = 25.0  # px; longer correlation is caused by errors of the instrument's shape
_LENGTH = 21.0  # px, correlation length
_CORRELATED = 0.95  # share of the variance
_CLIP = 2.5  # standard deviations
_REACH = 8  # px from the outline in which the mask's contour is searched
_GRID = 1 / 12  # px^2, variance of the quantisation to pixels
_INFLATION = 2.0  # factor on the variances, because the errors of fits are larger than the covariance predicts
_FARTHEST = 40.0  # px, between points whose errors are correlated
_STEPS = 6  # at most
_LARGEST_STEP = 6.0  # standard deviations


def is_rough(noise: OutlineNoise) -> bool:
    """Return whether the errors of a mask's contour are a segmentation's, not those of the quantisation to pixels."""
    return noise.sigma > _LEAST_SIGMA


def has_correlated_noise(noise: OutlineNoise) -> bool:
    """Return whether the noise of a mask's contour is of the kind that `fit_correlated` models."""
    return is_rough(noise) and noise.length < _LARGEST_LENGTH


def fit_correlated(
    refiner: OutlineRefiner,
    pose: Float64,
    joints: Float64,
    others: Sequence[tuple[OutlineRefiner, Float64]] = (),
) -> tuple[Float64, Float64]:
    """Refine a pose (4, 4) and joints (J,), already accurate to about a millimetre, with a refiner at full image size.

    Stops early if fewer than 40 outline points have a contour point within reach. ``others`` are the refiners of
    further views with their ``view_from_camera`` (4, 4); one with too few such points does not count.
    """
    for _ in range(_STEPS):
        terms = contour_terms(refiner, pose, joints)
        if terms is None and not others:
            return pose, joints
        information, slope = terms or _nothing(joints)
        for other, view_from_camera in others:
            more = contour_terms(other, view_from_camera @ pose, joints) or _nothing(joints)
            information, slope = information + more[0], slope + more[1]
        if not information.any():
            return pose, joints
        of_priors, slope_of_priors = refiner.priors.terms(pose[None], joints[None])
        information, slope = information + of_priors[0], slope + slope_of_priors[0]
        step = -np.linalg.solve(invertible(information), slope)
        size = float(np.sqrt(step @ information @ step))
        step *= min(1.0, _LARGEST_STEP / max(size, 1e-12))
        pose, joints = moved(pose, step[:6]), refiner.priors.clip_to_limits(joints + step[6:])
        if size < 0.3:
            break
    return pose, joints


def invertible(information: Float64) -> Float64:
    """Return an information matrix (M, M) with a little added: neither contour nor reading may tell a hidden joint."""
    diagonal = np.diag(information)
    return information + np.diag(1e-9 * diagonal + 1e-12 * max(float(diagonal.max()), 1.0))


def _nothing(joints: Float64) -> tuple[Float64, Float64]:
    """Return the information and the slope of a mask that tells nothing."""
    count = 6 + len(joints)
    return np.zeros((count, count)), np.zeros(count)


def contour_terms(
    refiner: OutlineRefiner, pose: Float64, joints: Float64, *, reach: int = _REACH
) -> tuple[Float64, Float64] | None:
    """Compute the outline's information (6 + J, 6 + J) and slope (6 + J,); None with fewer than 40 points in reach.

    ``reach``, px, is the distance from the outline in which the mask's contour is searched.
    """
    outline, jacobian = refiner.outline_jacobian(pose, joints)
    error, lengths = _contour_distances(refiner.mask, outline, reach)
    known = np.isfinite(error) & (sampled(refiner.weight, outline.pixels) > 0.5)
    if known.sum() < 40:
        return None
    sigma = max(1.4826 * float(np.median(np.abs(error[known]))), 0.5)
    index = np.flatnonzero(known & (np.abs(error) < _CLIP * sigma))
    error, lengths, pixels = error[index], lengths[index], outline.pixels[index]
    jacobian = jacobian[index] / lengths[:, None]
    variance = max(float(np.mean(error**2)) - _GRID / 2, 0.02)
    uncorrelated = variance * (1 - _CORRELATED) * _LENGTH + _GRID / lengths**2
    solved = solve_correlated(pixels, variance * _CORRELATED, uncorrelated, np.c_[jacobian, error])
    return jacobian.T @ solved[:, :-1] / _INFLATION, -jacobian.T @ solved[:, -1] / _INFLATION


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

    def covariance(first: NDArray[np.intp], second: NDArray[np.intp]) -> Float64:
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


def _contour_distances(mask: NDArray[np.bool_], outline: OutlinePoints, reach: int) -> tuple[Float64, Float64]:
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
        found = edges[row[:, None], np.clip(column, 0, edges.shape[1] - 1)] == -outwards[:, None]
        off = np.where(inside & found, column + 0.5 - along[:, None], np.inf)
        nearest = off[np.arange(len(index)), np.abs(off).argmin(axis=1)]
        error[index] = np.where(np.isfinite(nearest), nearest * outwards, np.nan)
    return error / lengths, lengths
