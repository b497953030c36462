"""Estimation of the size of the errors that last from frame to frame, from the fits of a session's frames.

Those standard deviations and correlation times are likely that make the frames' outlines likely, once the poses, the
errors of the readings and the calibration are eliminated. What is known of both beforehand was set on made and real
recordings; few frames hardly tell more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.blocks import Block
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.lasting_errors import USUAL_SIZE, LastingSize
from dvrk_cmaes.calibration.linearise import weak
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.solve import FrameFits, Solved, marginalise
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.pose.terms.term import Quadratic

_SCALE_STD, _SECONDS_STD = 0.5, 0.6  # of the logarithms of both, beforehand
_SCALES = USUAL_SIZE.scale * np.geomspace(0.2, 5.0, 11)
_SECONDS = USUAL_SIZE.seconds * np.geomspace(0.1, 10.0, 9)
_BLOCK = 40  # frames whose errors are compared with each other


@dataclass(frozen=True)
class LastingEstimate:
    """Size of the errors that last in a session, with standard deviations of the logarithms of factor and time.

    ``timed`` is whether the times of the frames were known. ``side_px``, px, is the standard deviation of the error of
    a side of the shaft (root mean square over the frames).
    """

    size: LastingSize
    log_std_scale: float
    log_std_seconds: float
    timed: bool
    side_px: float


def estimate_lasting(
    model: SessionModel, fits: Sequence[FrameFit], solution: Solved, times: Float64
) -> LastingEstimate:
    """Estimate the size of the errors that last.

    Parameters
    ----------
    model, fits, solution
        The session's model, the fits of its N frames and the solution of these. Fits that do not explain their masks do
        not count.
    times : (N,)
        Times of the frames, s; NaN where unknown.
    """
    most = max(fit.whole_outline.dimension for fit in fits)
    stacked = Quadratic.joined([fit.whole_outline.padded(most) for fit in fits])
    count = most - len(fits[0].slope)
    used = np.flatnonzero([fit.explains_mask for fit in fits])
    sides = np.array([fit.side_px for fit in fits])[used]
    rms = float(np.sqrt(np.mean(sides**2))) if len(used) else 0.0
    timed = bool(np.isfinite(times).sum() > 1)
    if not (count and len(used)):
        return LastingEstimate(USUAL_SIZE, _SCALE_STD, _SECONDS_STD, timed, rms)
    errors = {"lasting": np.zeros(count)}
    with_errors = FrameFits(Posed.stacked(fit.at for fit in fits), stacked, errors)
    frames = marginalise(model, with_errors, solution.calibration.beside(Block("lasting", np.ones(count)), **errors))
    jacobian = model.jacobian(solution.calibration)
    order = used[np.argsort(times[used], kind="stable")]
    blocks = [
        _Block.of(frames.left, jacobian, solution.weights, times, part)
        for part in np.array_split(order, -(-len(order) // _BLOCK))
    ]
    known = solution.calibration.information + weak(len(solution.information))
    log = np.array(
        [[_log_likelihood(blocks, known, LastingSize(scale, seconds)) for seconds in _SECONDS] for scale in _SCALES]
    )
    log -= 0.5 * (np.log(_SCALES / USUAL_SIZE.scale)[:, None] / _SCALE_STD) ** 2
    log -= 0.5 * (np.log(_SECONDS / USUAL_SIZE.seconds) / _SECONDS_STD) ** 2
    probability = np.exp(log - log.max())
    probability /= probability.sum()
    scale, std_scale = _moments(np.log(_SCALES), probability.sum(axis=1))
    seconds, std_seconds = _moments(np.log(_SECONDS), probability.sum(axis=0))
    size = LastingSize(float(np.exp(scale)), float(np.exp(seconds)))
    return LastingEstimate(size, std_scale, std_seconds, timed, size.scale * rms)


def _moments(values: Float64, probability: Float64) -> tuple[float, float]:
    """Return the mean and the standard deviation of values with some probabilities."""
    mean = float(values @ probability)
    return mean, float(np.sqrt((values - mean) ** 2 @ probability))


@dataclass(frozen=True, eq=False)
class _Block:
    """Frames as a function of the calibration (K) and of all of their lasting errors (N S).

    ``of_errors`` (N S, N S), ``cross`` (K, N S) and ``of_calibration`` (K, K) are the blocks of the information;
    ``slope_of_errors`` (N S,) and ``slope`` (K,) are the slopes. ``times`` (N,), s, are those of the frames.
    """

    of_errors: Float64
    cross: Float64
    of_calibration: Float64
    slope_of_errors: Float64
    slope: Float64
    times: Float64

    @classmethod
    def of(
        cls, left: Quadratic, jacobian: Float64, weights: Float64, times: Float64, index: NDArray[np.integer]
    ) -> _Block:
        """Stack the frames at some indices."""
        own = jacobian.shape[1]
        information = weights[index, None, None] * left.information[index]
        slope, down = weights[index, None] * left.slope[index], np.swapaxes(jacobian[index], 1, 2)
        count = left.dimension - own
        of_errors = np.zeros((len(index), count, len(index), count))
        of_errors[np.arange(len(index)), :, np.arange(len(index))] = information[:, own:, own:]
        size = len(index) * count
        return cls(
            of_errors=of_errors.reshape(size, size),
            cross=np.concatenate([*(down @ information[:, :own, own:])], axis=1),
            of_calibration=(down @ information[:, :own, :own] @ jacobian[index]).sum(axis=0),
            slope_of_errors=slope[:, own:].ravel(),
            slope=(down @ slope[:, :own, None])[:, :, 0].sum(axis=0),
            times=times[index],
        )


def _log_likelihood(blocks: Sequence[_Block], known: Float64, size: LastingSize) -> float:
    """Return the logarithm of the likelihood of a size up to a constant, the calibration (K) eliminated."""
    total, information, slope = 0.0, known.copy(), np.zeros(len(known))
    for block in blocks:
        count = len(block.slope_of_errors) // len(block.times)
        root = size.scale * np.kron(np.linalg.cholesky(size.correlation(block.times)), np.eye(count))
        inner = np.eye(len(root)) + root.T @ block.of_errors @ root
        right = root.T @ np.column_stack([block.slope_of_errors, block.cross.T])
        solved = np.linalg.solve(inner, right)
        total += 0.5 * float(right[:, 0] @ solved[:, 0]) - 0.5 * float(np.linalg.slogdet(inner)[1])
        information += block.of_calibration - right[:, 1:].T @ solved[:, 1:]
        slope += block.slope - right[:, 1:].T @ solved[:, 0]
    total += 0.5 * float(slope @ np.linalg.solve(information, slope))
    return total - 0.5 * float(np.linalg.slogdet(information)[1])
