"""Information about a pose from its outline and priors: the inverse of the covariance that a result states.

Each correlation length of outline is one measurement. Its standard deviation is that of the link to which the outline
belongs, because an occluder over the jaws or a shadow beside the shaft makes the contour worse on one link only. On a
rough contour the length is a constant: that of a single frame varies by a factor of two around it, which says nothing
about the error of the pose, and shadows make it longer. What stretches of contour have in common is eliminated (see
`shared_errors`).

Of several poses that are refined together some are worth further iterations. What each of several frames has for itself
is eliminated, so that only unknowns that all of them share remain.

Let x (D) be a frame's own unknowns and c (E) the shared ones. The frame's terms are quadratic in both, with the blocks
H, B and C of their information and the slopes s and t where x and c are zero. Beside them, x is expected to be near p
with the information W. Elimination of x, with S = (H + W)^-1, leaves x = S (W p - s - B c), the gradients W (p - x)
about p and B^T x + C c + t about c, and the Hessian's blocks W - W S W, W S B and C - B^T S B.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dvrk_cmaes.evidence.outline_noise import CLIP, OutlineNoise, distances_to, sampled
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.pose.terms.coverage import is_rough
from dvrk_cmaes.pose.terms.shared_errors import shared_errors, without_last
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic, Term, sum_of_locals
from dvrk_cmaes.silhouette import OutlinePoints

# Largest standard deviations of position, m, and of angles, rad; they keep the information invertible.
_POSITION_SIGMA, _ANGLE_SIGMA = 1.0, np.pi
_LARGEST = 8.0  # standard deviations to which errors are limited in the variance of a link
_SHARED = 100.0  # px of outline; weight of the variance of the whole outline in that of a link
_ROUGH_LENGTH = 20.0  # px, correlation length of the errors of a rough contour
_ROUGH_FACTOR, _SMOOTH_FACTOR = 0.45, 0.25  # on the variance of a measurement; fitted as those of `shared_errors`
_LARGE = 1.5  # px, standard deviation of errors that are neither small nor normal, by which the variance doubles


def information_of_views(views: Sequence[SizedView], terms: Sequence[Term], at: Posed) -> list[Float64]:
    """Compute the information (6 + J, 6 + J) of each view, at its whole size, about the changes of one fitted pose.

    That of the first view includes the other ``terms``. The errors of the masks of different views are taken to be
    independent.
    """
    information = []
    for k, view in enumerate(views):
        of_view = outline_information(view, at, view.view.noise_at(at))
        if k == 0:
            of_view = of_view + sum_of_locals(terms, Posed.stacked([at])).information[0]
            largest = np.array([_POSITION_SIGMA] * 3 + [_ANGLE_SIGMA] * (len(of_view) - 3))
            of_view = of_view + np.diag(1 / largest**2)
        information.append(of_view)
    return information


def outline_information(view: SizedView, at: Posed, noise: OutlineNoise) -> Float64:
    """Compute the information (6 + J, 6 + J) of the outline alone about the small changes of one fitted pose.

    ``noise`` is that of the whole contour. Points at ignored pixels or farther than three standard deviations from the
    mask's outline do not count.
    """
    (outline,) = view.outlines(Posed.stacked([at]))
    (of_pose,) = view.jacobians([outline], Posed.stacked([at]))
    off = distances_to(view.mask, outline.pixels)
    weight = sampled(view.weight, outline.pixels)
    length = np.linalg.norm(outline.normals, axis=1)
    seen = at.seen_from(view.view.view_from_camera)
    columns, deviations = shared_errors(outline, view.renderer.body.instrument, view.camera, seen, noise)
    jacobian = np.column_stack([of_pose, columns * length[:, None]])
    counts = weight * (np.abs(off) < CLIP * max(noise.sigma, 0.5))
    variance = _link_variances(outline, off, length * weight, noise.sigma)[outline.link]
    weighted = jacobian * (counts / (length * variance * _length_of_measurement(noise)))[:, None]
    both = Quadratic((jacobian.T @ weighted)[None], np.zeros((1, jacobian.shape[1])))
    return np.asarray(without_last(both, np.diag(1 / deviations**2)).information[0])


def _length_of_measurement(noise: OutlineNoise) -> float:
    """Return the length of outline, px, that is one measurement with the variance of its link."""
    large = 1 + (noise.sigma / _LARGE) ** 2
    return large * (_ROUGH_FACTOR * _ROUGH_LENGTH if is_rough(noise) else _SMOOTH_FACTOR * noise.length)


def _link_variances(outline: OutlinePoints, off: Float64, length: Float64, sigma: float) -> Float64:
    """Estimate the variance of the outline's error on each link, px^2, from errors (N,) and lengths (N,), px.

    It is the mean of the link's squared errors and of ``_SHARED`` px with the variance of the whole outline.
    """
    square = np.clip(off, -_LARGEST * sigma, _LARGEST * sigma) ** 2
    sums = np.bincount(outline.link, length * square)
    lengths = np.bincount(outline.link, length)
    return np.asarray((sums + _SHARED * sigma**2) / (lengths + _SHARED))


_OF_OUTLINE = 1 / 3
"""Difference of the outline's score alone that keeps a pose, as a share of that of the whole score."""


@dataclass(frozen=True)
class Selection:
    """The poses that continue after each iteration of a refinement, the best by their scores.

    They are the best ``share`` of those that continued before, and of these such as are close to the best: within
    ``gap`` of its negative log-likelihood, or within a third of that of the best outline's alone, so that an outline
    may contradict the readings. At least ``least`` continue in any case.
    """

    share: float = 1.0
    gap: float = np.inf
    least: int = 1

    def continuing(self, scores: ArrayLike, outline_scores: ArrayLike, left: float) -> list[int]:
        """Return the indices of the poses that continue, best first, if about ``left`` of them continued before.

        ``scores`` are the negative log-likelihoods, ``outline_scores`` the parts of them that come from the outline.
        """
        whole, outline = np.asarray(scores), np.asarray(outline_scores)
        close = (whole <= whole.min() + self.gap) | (outline <= outline.min() + self.gap * _OF_OUTLINE)
        best = np.argsort(whole, kind="stable")[: max(round(left), self.least)]
        return [int(i) for place, i in enumerate(best) if place < self.least or close[i]]


ALL = Selection()
"""All poses continue until they have settled."""


@dataclass(frozen=True, eq=False)
class Eliminated:
    """N frames after elimination of their own D unknowns, of which ``expected`` (N, D) is what is expected.

    ``left`` is half of each frame's sum of squares, at its minimum over the own unknowns, as a function of changes of
    what is expected and of the shared unknowns, (N, D + E). ``own`` (N, D) are the own unknowns at that minimum and
    ``gain`` (N, D, D + E) their derivative by the same; ``covariance`` (N, D, D) is theirs, given these.
    """

    expected: Float64
    left: Quadratic
    own: Float64
    gain: Float64
    covariance: Float64

    @property
    def deviation(self) -> Float64:
        """Difference (N, D) of the own unknowns from what is expected."""
        return np.asarray(self.own - self.expected)


def eliminate(terms: Quadratic, expected: Float64, information: Float64, shared: Float64) -> Eliminated:
    """Eliminate the own unknowns of N frames.

    Parameters
    ----------
    terms
        Each frame's terms about its own unknowns and E shared ones, (N, D + E).
    expected : (N, D)
        What is expected of the own unknowns, as changes from where the terms were approximated.
    information : (N, D, D)
        The inverse covariance of the own unknowns about that; zero where nothing is expected.
    shared : (E,)
        Values of the shared unknowns, as changes from where the terms were approximated.
    """
    own = expected.shape[1]
    cross, of_shared = terms.information[:, :own, own:], terms.information[:, own:, own:]
    across = np.swapaxes(cross, 1, 2)
    covariance = np.asarray(np.linalg.inv(terms.information[:, :own, :own] + information), dtype=np.float64)
    best = times(covariance, times(information, expected) - (terms.slope[:, :own] + cross @ shared))
    coupling = np.concatenate([information, -cross], axis=2)
    left = -(np.concatenate([information, -across], axis=1) @ covariance @ coupling)
    left[:, :own, :own] += information
    left[:, own:, own:] += of_shared
    about_shared = times(across, best) + terms.slope[:, own:] + of_shared @ shared
    slope = np.concatenate([times(information, expected - best), about_shared], axis=1)
    return Eliminated(expected, Quadratic(left, slope), best, covariance @ coupling, covariance)


def times(matrices: Float64, vectors: Float64) -> Float64:
    """Multiply matrices (N, D, K) by vectors (N, K)."""
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))
