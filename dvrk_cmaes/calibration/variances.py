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
from dvrk_cmaes.geometry import Float64

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
    rotation = squares.new_std(start.outer[0], current.outer[0], turns, config.arm_std_factor)
    insertion = squares.new_std(start.outer[2], current.outer[2], squares.of(loadings[2]), config.arm_std_factor / 2)
    outer[:2], outer[2] = max(rotation, start.outer[0]), max(insertion, start.outer[2])
    outer[3] = squares.new_std(start.outer[3], current.outer[3], squares.of(loadings[3]), config.cable_std_factor)
    joints = np.zeros_like(start.joints)
    for j in range(len(joints)):
        own = squares.along(6 + j, current.joints[j] * model.inflation[:, 1 + j])
        joints[j] = squares.new_std(start.joints[j], current.joints[j], own, config.cable_std_factor)
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
