"""Smoothing of what a recording's frames deviate from its calibration's predictions, over time.

The deviations of a frame (slack of the arm, errors of roll and joints) are those of the calibration's model. A part of
them wanders slowly, the rest changes from frame to frame: both are Gauss-Markov processes of first order. The outline
tells each frame's deviation by a quadratic term. The most probable deviations of all frames together follow from one
block-tridiagonal system.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from dvrk_cmaes import _kernel
from dvrk_cmaes.geometry import Float64

SLOW_SHARE: Final = 0.8
SLOW_SECONDS: Final = 0.5
FAST_SECONDS: Final = 0.1

_JITTER = 1e-9  # of a covariance, so that it can be inverted


def smoothed_deviations(
    times: Float64,
    prior: Float64,
    information: Float64,
    optimum: Float64,
    jacobian: Float64,
    by_masks: Float64,
    *,
    only_last: bool = False,
    slow_share: float = SLOW_SHARE,
    slow: float = SLOW_SECONDS,
    fast: float = FAST_SECONDS,
) -> tuple[Float64, Float64, Float64]:
    """Find the most probable deviations of all frames, or of the last one only, N = 1, given all.

    They are the sums of slow and fast parts, M = 2 D, of a block-tridiagonal system.

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
    only_last
        Whether only the last deviation is found.
    slow_share, slow, fast
        Share of the variance that wanders slowly, and the times, s, over which both parts do.

    Returns
    -------
    deviations : (N, D)
        Those of the frames from their predictions.
    covariance : (N, D, D)
        That of the deviations.
    response : (N, D, K + E)
        Change of the frames' poses and joints with the calibration, and per px of the masks' errors.
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
    pivots, sides = _kernel.eliminate_chain(diagonal, beside, np.tile(right, (1, 2, 1)))
    if only_last:
        pivots, found = pivots[-1:], pivots[-1:] @ sides[-1:]
    else:
        found, pivots = _substituted(pivots, sides, beside)
    found = both @ found
    moves = np.concatenate([jacobian, np.zeros_like(by_masks)], axis=2)[-len(found) :]
    return found[:, :, 0], both @ pivots @ both.T, moves + found[:, :, 1:]


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
