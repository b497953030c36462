"""Elimination of what each of several frames has for itself, so that only unknowns that all of them share remain.

Let x (D) be a frame's own unknowns and c (E) the shared ones. The frame's terms are quadratic in both, with the blocks
H, B and C of their information and the slopes s and t where x and c are zero. Beside them, x is expected to be near p
with the information W. Elimination of x, with S = (H + W)^-1, leaves x = S (W p - s - B c), the gradients W (p - x)
about p and B^T x + C c + t about c, and the Hessian's blocks W - W S W, W S B and C - B^T S B.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.pose.terms.term import Quadratic


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
