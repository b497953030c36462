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

from dvrk_cmaes import _kernel
from dvrk_cmaes.geometry import Float64

SLOW_SHARE: Final = 0.8
SLOW_SECONDS: Final = 0.5
FAST_SECONDS: Final = 0.1

_JITTER = 1e-9  # of a covariance, so that it can be inverted


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Deviations (N, D) of frames from their predictions, and their covariances (N, D, D).

    ``response`` (N, D, K + E) is the change of the frames' poses and joints with the calibration, and per px of the
    masks' errors.
    """

    deviations: Float64
    covariance: Float64
    response: Float64


@dataclass(frozen=True, eq=False)
class FrameDeviations:
    """The deviations of N frames as a block-tridiagonal system of their slow and fast parts (N, M), M = 2 D.

    ``diagonal`` (N, M, M), ``beside`` (N - 1, M, M) between a frame and the next one, ``right`` (N, M, 1 + R) the right
    sides; ``both`` (D, M) sums the parts. ``moves`` (N, D, R) are the changes of the predictions with each of R errors.
    """

    diagonal: Float64
    beside: Float64
    right: Float64
    both: Float64
    moves: Float64

    @classmethod
    def of(
        cls,
        times: Float64,
        prior: Float64,
        information: Float64,
        optimum: Float64,
        jacobian: Float64,
        by_masks: Float64,
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
        by_masks : (N, D, E)
            Change of ``optimum`` per px of E errors that all masks share.
        slow_share, slow, fast
            Share of the variance that wanders slowly, and the times, s, over which both parts do.
        """
        size, parts = optimum.shape[1], np.array([slow_share, 1 - slow_share])
        left = np.exp(-np.diff(times)[:, None] / np.array([slow, fast]))  # of both parts, from a frame to the next one
        noise = parts * (1 - left**2 + _JITTER)
        # A covariance is carried to the next frame as its Cholesky factor, since it may be another one there.
        inverse_root = np.linalg.inv(np.linalg.cholesky(prior))
        turned = inverse_root.swapaxes(1, 2)
        own, across = turned @ inverse_root, turned[:-1] @ inverse_root[1:]
        factors = np.concatenate([1 / parts[None], 1 / noise])
        factors[:-1] += left**2 / noise
        diagonal = np.tile(information, (1, 2, 2))  # the deviation is the sum of both parts
        beside = np.zeros((len(left), 2 * size, 2 * size))  # between a frame and the next one
        for k, part in enumerate((slice(0, size), slice(size, None))):
            diagonal[:, part, part] += factors[:, k, None, None] * own
            beside[:, part, part] = -(left / noise)[:, k, None, None] * across
        right = np.concatenate([optimum[:, :, None], -information @ jacobian, by_masks], axis=2)
        both = np.tile(np.eye(size), 2)
        moves = np.concatenate([jacobian, np.zeros_like(by_masks)], axis=2)
        return cls(diagonal, beside, np.tile(right, (1, 2, 1)), both, moves)

    def smoothed(self, *, only_last: bool = False) -> Smoothed:
        """Find the most probable deviations of all frames, or of the last one only, N = 1, given all."""
        pivots, sides = _kernel.eliminate_chain(self.diagonal, self.beside, self.right)
        if only_last:
            pivots, found = pivots[-1:], pivots[-1:] @ sides[-1:]
        else:
            found, pivots = _substituted(pivots, sides, self.beside)
        found = self.both @ found
        moves = self.moves[-len(found) :]
        return Smoothed(found[:, :, 0], self.both @ pivots @ self.both.T, moves + found[:, :, 1:])


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
