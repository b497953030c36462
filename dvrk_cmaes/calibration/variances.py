"""Estimation of the variance components of the readings from a session.

The variance components follow by expectation-maximisation. The expectation step computes the posterior mean square of
each error in each frame. The maximisation step takes its weighted mean over the frames; the configured initial value
counts as ``spread_frames`` further frames. Standard deviations are limited: those of yaw, pitch and insertion from
below and the slack from above by their initial values, and all but the slack from above by multiples of these. Single
large errors of roll or of an instrument's joint (a slipped cable, a reading of another time) are handled apart from
these: the standard deviation of that joint is inflated in that frame only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dvrk_cmaes.calibration.model import Deviations, SessionModel
from dvrk_cmaes.calibration.solve import MOST_STEPS, ArmFrames, FrameFits, Solved, marginalise, solve_arms
from dvrk_cmaes.config import SessionConfig

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
    first, now = (np.concatenate([*vars(one).values()]) for one in (start, model.deviations))
    joints, weights = len(model.names), solution.weights
    frames = marginalise(model, fits, solution.calibration)
    # of standard normal errors of outer joints, joints and slack, (N, 6 + J, 10 + J)
    own = np.roll(np.eye(6 + joints), 6, axis=0) * now[4:]
    own = own * np.hstack([model.inflation[:, 1:], np.ones((len(weights), 6))])[:, None]
    loadings = np.concatenate([np.moveaxis(model.outer_loadings(solution.calibration), 0, 2), own], axis=2)
    gains = np.linalg.solve(model.covariance(solution.calibration), loadings)
    means, spreads = np.einsum("ndk,nd->nk", gains, frames.deviation), frames.covariance @ gains
    squares = means**2 + 1 - (gains * loadings).sum(axis=1) + (gains * spreads).sum(axis=1)
    for alike in (slice(0, 2), slice(-6, -3), slice(-3, None)):  # yaw and pitch, the slack of place and of rotation
        squares[:, alike] = squares[:, alike].mean(axis=1, keepdims=True)
    factors = config.arm_std_factor, config.arm_std_factor / 2, config.cable_std_factor, 1.0
    most = first * np.repeat(factors, [2, 1, 1 + joints, 6])
    total = config.spread_frames * first**2 + weights @ np.minimum(squares * now**2, most**2)
    values = np.sqrt(total / (config.spread_frames + weights.sum()))
    values[:3] = np.maximum(values[:3], first[:3])
    standardised = np.abs(frames.deviation[:, 5:]) / values[3:-6]
    largest = [_MAX_ROLL_INFLATION] + [_MAX_JOINT_INFLATION] * joints
    inflation = np.clip(standardised / config.tail, 1.0, largest)
    return replace(model, deviations=Deviations(*np.split(values, [4, 4 + joints])), inflation=inflation)
