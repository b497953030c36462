"""Estimation of the variance components of the readings' errors from a session, by expectation-maximisation.

The expectation step computes the posterior mean square of each error in each frame. The maximisation step takes its
weighted mean over the frames; the configured initial value counts as ``spread_frames`` further frames. Standard
deviations are limited: those of yaw, pitch and insertion from below and the slack from above by their initial values,
and all but the slack from above by multiples of these.

Single large errors of roll or of an instrument's joint (a slipped cable, a reading of another time) are handled apart
from these: the standard deviation of that joint is inflated in that frame only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration
from dvrk_cmaes.calibration.model import Deviations, SessionModel
from dvrk_cmaes.calibration.solve import MOST_STEPS, FrameFits, Solved, marginalise, solve
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Float64

_ITERATIONS = 3  # of both estimates
_MAX_ROLL_INFLATION, _MAX_JOINT_INFLATION = 20.0, 2.0
"""Largest factors on standard deviations in single frames; a mask determines the rotation about the shaft least."""


def solve_with_variances(
    model: SessionModel,
    fits: FrameFits,
    start: Calibration,
    config: SessionConfig,
    initial: Deviations | None = None,
    *,
    steps: int = MOST_STEPS,
) -> tuple[SessionModel, Solved]:
    """Alternate between estimating the calibration and the variances; arguments as in `solve` and below."""
    for _ in range(_ITERATIONS):
        solution = solve(model, fits, start, steps=steps)
        model, start = estimate_variances(model, fits, solution, config, initial), solution.calibration
    return model, solution


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
    calibration, weights = solution.calibration, solution.weights
    frames = marginalise(model, fits, calibration)
    inverse = np.linalg.inv(model.covariance(calibration))

    def mean_squares(loading: Float64) -> Float64:
        """Compute posterior mean squares (N,) of a standard normal error that changes the frames by (N, D) times it."""
        gain = np.einsum("nij,nj->ni", inverse, loading)
        mean = (gain * frames.deviation).sum(axis=1)
        spread = np.einsum("nij,nj->ni", frames.covariance, gain)
        variance = 1 - (gain * loading).sum(axis=1) + (gain * spread).sum(axis=1)
        return np.asarray(mean**2 + variance)

    def new_std(initial: float, current: float, squares: Float64, growth: float) -> float:
        """Return a standard deviation from mean squares (N,) in units of the current one."""
        capped = np.minimum(squares * current**2, (growth * initial) ** 2)
        total = config.spread_frames * initial**2 + (weights * capped).sum()
        return float(np.sqrt(total / (config.spread_frames + weights.sum())))

    def axis_loading(axis: int, std: Float64 | float) -> Float64:
        """Return the change (N, D) of each frame by a standard deviation, a number or (N,), along one of its axes."""
        out = np.zeros((len(weights), 6 + len(start.joints)))
        out[:, axis] = std
        return out

    current, loadings = model.deviations, model.outer_loadings(calibration)
    outer = start.outer.copy()
    rotation_squares = (mean_squares(loadings[0]) + mean_squares(loadings[1])) / 2
    rotation = new_std(start.outer[0], current.outer[0], rotation_squares, config.arm_growth)
    insertion = new_std(start.outer[2], current.outer[2], mean_squares(loadings[2]), config.arm_growth / 2)
    outer[:2], outer[2] = max(rotation, start.outer[0]), max(insertion, start.outer[2])
    outer[3] = new_std(start.outer[3], current.outer[3], mean_squares(loadings[3]), config.cable_growth)
    joints = np.zeros_like(start.joints)
    for j in range(len(joints)):
        squares = mean_squares(axis_loading(6 + j, current.joints[j] * model.inflation[:, 1 + j]))
        joints[j] = new_std(start.joints[j], current.joints[j], squares, config.cable_growth)
    slack = start.slack.copy()
    for part in (slice(0, 3), slice(3, 6)):
        squares = np.mean([mean_squares(axis_loading(k, current.slack[k])) for k in range(6)[part]], axis=0)
        slack[part] = new_std(start.slack[part][0], current.slack[part][0], squares, 1.0)
    estimated = Deviations(outer, joints, slack)
    standardised = np.concatenate([frames.deviation[:, 5:6] / outer[3], frames.deviation[:, 6:] / joints], axis=1)
    most = np.array([_MAX_ROLL_INFLATION] + [_MAX_JOINT_INFLATION] * len(joints))
    inflation = np.clip(np.abs(standardised) / config.tail, 1.0, most)
    return replace(model, deviations=estimated, inflation=inflation)
