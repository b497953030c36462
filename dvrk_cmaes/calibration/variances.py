"""Estimation of the sizes of errors from a session: variance components of the readings, and errors of masks.

The variance components follow by expectation-maximisation. The expectation step computes the posterior mean square of
each error in each frame. The maximisation step takes its weighted mean over the frames; the configured initial value
counts as ``spread_frames`` further frames. Standard deviations are limited: those of yaw, pitch and insertion from
below and the slack from above by their initial values, and all but the slack from above by multiples of these. Single
large errors of roll or of an instrument's joint (a slipped cable, a reading of another time) are handled apart from
these: the standard deviation of that joint is inflated in that frame only.

Of the masks' errors that are autocorrelated from frame to frame, those standard deviations and correlation times are
likely that make the frames' outlines likely, once the poses, the errors of the readings and the calibration are
eliminated. What is known of both beforehand was set on made and real recordings; few frames hardly tell more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.blocks import Block
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.lasting_errors import USUAL_SIZE, LastingSize
from dvrk_cmaes.calibration.linearise import weak
from dvrk_cmaes.calibration.model import Deviations, SessionModel
from dvrk_cmaes.calibration.solve import MOST_STEPS, ArmFrames, FrameFits, Solved, marginalise, solve_arms
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.pose.terms.term import Quadratic

_ITERATIONS = 3  # of both estimates
_MAX_ROLL_INFLATION, _MAX_JOINT_INFLATION = 20.0, 2.0
"""Largest factors on standard deviations in single frames; a mask determines the rotation about the shaft least."""


def solve_with_variances(
    arms: Sequence[ArmFrames],
    config: SessionConfig,
    initial: Sequence[Deviations | None] | None = None,
    *,
    steps: int = MOST_STEPS,
) -> tuple[list[SessionModel], list[Solved]]:
    """Alternate between estimating the calibrations and the variances of each arm; arguments as in `solve_arms`.

    ``config`` and ``initial``, by arm, are as in `estimate_variances`.
    """
    starts = [None] * len(arms) if initial is None else list(initial)
    for _ in range(_ITERATIONS):
        solutions = solve_arms(arms, steps=steps)
        models = [
            estimate_variances(arm.model, arm.fits, own, config, start)
            for arm, own, start in zip(arms, solutions, starts, strict=True)
        ]
        each = zip(arms, models, solutions, strict=True)
        arms = [ArmFrames(model, arm.fits, own.calibration) for arm, model, own in each]
    return models, solutions


def estimate_variances(
    model: SessionModel,
    fits: FrameFits,
    solution: Solved,
    config: SessionConfig,
    initial: Deviations | None = None,
) -> SessionModel:
    """Return the model after one iteration of expectation-maximisation.

    Parameters
    ----------
    model, fits
        The current model and the outline fits of the same N frames.
    solution
        Their solution: the calibration, taken as known, and the robust weights of the frames.
    config
        Initial standard deviations and their limits.
    initial
        Initial standard deviations, where they are not those of ``config``.
    """
    start = Deviations.of(config, model.names) if initial is None else initial
    squares = _Squares(model, fits, solution, config)
    current, loadings = model.deviations, model.outer_loadings(solution.calibration)
    outer = start.outer.copy()
    turns = (squares.of(loadings[0]) + squares.of(loadings[1])) / 2
    rotation = squares.new_std(start.outer[0], current.outer[0], turns, config.arm_growth)
    insertion = squares.new_std(start.outer[2], current.outer[2], squares.of(loadings[2]), config.arm_growth / 2)
    outer[:2], outer[2] = max(rotation, start.outer[0]), max(insertion, start.outer[2])
    outer[3] = squares.new_std(start.outer[3], current.outer[3], squares.of(loadings[3]), config.cable_growth)
    joints = np.zeros_like(start.joints)
    for j in range(len(joints)):
        own = squares.along(6 + j, current.joints[j] * model.inflation[:, 1 + j])
        joints[j] = squares.new_std(start.joints[j], current.joints[j], own, config.cable_growth)
    slack = start.slack.copy()
    for part in (slice(0, 3), slice(3, 6)):
        own = np.mean([squares.along(k, current.slack[k]) for k in range(6)[part]], axis=0)
        slack[part] = squares.new_std(start.slack[part][0], current.slack[part][0], own, 1.0)
    off = squares.frames.deviation
    standardised = np.concatenate([off[:, 5:6] / outer[3], off[:, 6:] / joints], axis=1)
    most = np.array([_MAX_ROLL_INFLATION] + [_MAX_JOINT_INFLATION] * len(joints))
    inflation = np.clip(np.abs(standardised) / config.tail, 1.0, most)
    return replace(model, deviations=Deviations(outer, joints, slack), inflation=inflation)


class _Squares:
    """Posterior mean squares of the errors of N frames; arguments as in `estimate_variances`."""

    def __init__(self, model: SessionModel, fits: FrameFits, solution: Solved, config: SessionConfig) -> None:
        self._weights, self._config = solution.weights, config
        self.frames = marginalise(model, fits, solution.calibration)
        self._inverse = np.linalg.inv(model.covariance(solution.calibration))

    def of(self, loading: Float64) -> Float64:
        """Compute those (N,) of a standard normal error that changes the frames by (N, D) times it."""
        gain = np.einsum("nij,nj->ni", self._inverse, loading)
        mean = (gain * self.frames.deviation).sum(axis=1)
        spread = np.einsum("nij,nj->ni", self.frames.covariance, gain)
        variance = 1 - (gain * loading).sum(axis=1) + (gain * spread).sum(axis=1)
        return np.asarray(mean**2 + variance)

    def along(self, axis: int, std: Float64 | float) -> Float64:
        """Compute those (N,) of an error along one axis with a standard deviation, a number or (N,)."""
        loading = np.zeros(self.frames.deviation.shape)
        loading[:, axis] = std
        return self.of(loading)

    def new_std(self, initial: float, current: float, squares: Float64, most: float) -> float:
        """Return a standard deviation from mean squares (N,) in units of the current one, at most a multiple."""
        capped = np.minimum(squares * current**2, (most * initial) ** 2)
        total = self._config.spread_frames * initial**2 + (self._weights * capped).sum()
        return float(np.sqrt(total / (self._config.spread_frames + self._weights.sum())))


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
        _Frames.of(frames.left, jacobian, solution.weights, times, part)
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
class _Frames:
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
    ) -> _Frames:
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


def _log_likelihood(blocks: Sequence[_Frames], known: Float64, size: LastingSize) -> float:
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
