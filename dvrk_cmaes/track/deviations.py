"""Smoothing of what a recording's frames deviate from its calibration's predictions, over time.

The deviations of a frame (slack of the arm, errors of roll and joints) are those of the calibration's model. A part of
them wanders slowly, the rest changes from frame to frame: both are Gauss-Markov processes of first order. The outline
tells each frame's deviation by a quadratic term. The most probable deviations of all frames together follow from one
block-tridiagonal system.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.silhouette.threads import single_blas_thread

SLOW_SHARE: Final = 0.8
SLOW_SECONDS: Final = 0.5
FAST_SECONDS: Final = 0.1

_JITTER = 1e-9  # of a covariance, so that it can be inverted


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Deviations (N, D) of frames from their predictions, and their covariances (N, D, D).

    ``response`` (N, D, K) is the change of the frames' poses and joints with the calibration.
    """

    deviations: Float64
    covariance: Float64
    response: Float64


@dataclass(frozen=True, eq=False)
class FrameDeviations:
    """The deviations of N frames as a block-tridiagonal system of their slow and fast parts (N, M), M = 2 D.

    ``diagonal`` (N, M, M), ``beside`` (N - 1, M, M) between a frame and the next one, ``right`` (N, M, 1 + K) the right
    sides; ``both`` (D, M) sums the parts. ``jacobian`` is that of `of`.
    """

    diagonal: Float64
    beside: Float64
    right: Float64
    both: Float64
    jacobian: Float64

    @classmethod
    @single_blas_thread()
    def of(
        cls,
        times: Float64,
        prior: Float64,
        information: Float64,
        optimum: Float64,
        jacobian: Float64,
        *,
        slow_share: float = SLOW_SHARE,
        slow: float = SLOW_SECONDS,
        fast: float = FAST_SECONDS,
    ) -> FrameDeviations:
        """Set the system up.

        Parameters
        ----------
        times : (N,)
            Times of the frames, s, increasing.
        prior : (N, D, D)
            Covariance of each frame's deviation.
        information : (N, D, D)
            What each outline tells: the matrix of its quadratic term; zero for a frame without one.
        optimum : (N, D)
            The information times the deviation at which that term is least.
        jacobian : (N, D, K)
            Change of the predictions with the calibration.
        slow_share, slow, fast
            Share of the variance that wanders slowly, and the times, s, over which both parts do.
        """
        size = optimum.shape[1]
        both = np.concatenate([np.eye(size), np.eye(size)], axis=1)  # the deviation is the sum of both parts
        covariance = np.zeros((len(prior), 2 * size, 2 * size))
        covariance[:, :size, :size] = slow_share * prior
        covariance[:, size:, size:] = (1 - slow_share) * prior
        scale = np.repeat([slow, fast], size)
        steps = np.exp(-np.diff(times)[:, None] / scale)
        diagonal = np.zeros_like(covariance)
        beside = np.zeros((0, 2 * size, 2 * size))  # between a frame and the next one
        diagonal[0] = np.linalg.inv(covariance[0])
        if len(steps):
            root = _carried(prior, steps, size)
            noise = covariance[1:] - root @ covariance[:-1] @ root.swapaxes(1, 2)
            precision = np.linalg.inv(noise + _JITTER * covariance[1:])
            beside = -root.swapaxes(1, 2) @ precision
            diagonal[:-1] -= beside @ root
            diagonal[1:] += precision
        diagonal += both.T @ information @ both
        right = np.concatenate([optimum[:, :, None], -information @ jacobian], axis=2)
        return cls(diagonal, beside, both.T @ right, both, jacobian)

    @single_blas_thread()
    def smoothed(self, *, only_last: bool = False) -> Smoothed:
        """Find the most probable deviations of all frames, or of the last one only, N = 1, given all."""
        pivots, sides = _eliminated(self.diagonal, self.beside, self.right)
        if only_last:
            pivots, found = pivots[-1:], pivots[-1:] @ sides[-1:]
        else:
            found, pivots = _substituted(pivots, sides, self.beside)
        found = self.both @ found
        jacobian = self.jacobian[-len(found) :]
        return Smoothed(found[:, :, 0], self.both @ pivots @ self.both.T, jacobian + found[:, :, 1:])


def _carried(prior: Float64, steps: Float64, size: int) -> Float64:
    """Return the matrices (N - 1, M, M) that carry both parts of the deviation to the next frame.

    ``prior`` (N, D, D) are the frames' covariances, which change from frame to frame; ``steps`` (N - 1, M) are what is
    left of each part. A share of a covariance is carried as the whole of it.
    """
    lower = np.linalg.cholesky(prior)
    carried = lower[1:] @ np.linalg.inv(lower[:-1])
    out = np.zeros((len(steps), 2 * size, 2 * size))
    for part in (slice(0, size), slice(size, None)):
        out[:, part, part] = steps[:, part, None] * carried
    return out


def _substituted(pivots: Float64, sides: Float64, beside: Float64) -> tuple[Float64, Float64]:
    """Solve a system whose frames were eliminated, for columns (N, M, C).

    Also returns the diagonal blocks (N, M, M) of the inverse.
    """
    solution, blocks = pivots @ sides, pivots.copy()
    for k in range(len(pivots) - 2, -1, -1):
        gain = pivots[k] @ beside[k]
        solution[k] -= gain @ solution[k + 1]
        blocks[k] += gain @ blocks[k + 1] @ gain.T
    return solution, blocks


def _eliminated(diagonal: Float64, beside: Float64, right: Float64) -> tuple[Float64, Float64]:
    """Eliminate the frames of a system one after the other.

    Returns the inverses (N, M, M) of what is left of the diagonal, and what is left of the right sides (N, M, C).
    """
    pivots, sides = np.empty_like(diagonal), right.copy()
    pivots[0] = np.linalg.inv(diagonal[0])
    for k in range(1, len(diagonal)):
        gain = beside[k - 1].T @ pivots[k - 1]
        pivots[k] = np.linalg.inv(diagonal[k] - gain @ beside[k - 1])
        sides[k] = right[k] - gain @ sides[k - 1]
    return pivots, sides
