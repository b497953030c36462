"""Robust Gauss-Newton estimation of a session's calibration from the outline fits of its frames.

The unknowns of the N frames (D = 6 + J each, pose and joints) are eliminated. Let H be the information matrix of a
frame's outline about its pose and joints, and W = P^-1 that of the model's prediction with covariance P. The
information about the prediction is then the Schur complement W - W (H + W)^-1 W, so the cost is linear in the number of
frames. Frames with large misfits are down-weighted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.consensus import Mode
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.geometry import change_between

Float64 = NDArray[np.float64]

_ROBUST = 2.0
"""Scale of the Geman-McClure weights, in expected errors: a frame's weight is 1 up to one and 0.4 at two."""

_ITERATIONS = 30
_PARTS = 8  # of a recording, whose errors are taken for independent of each other


@dataclass(frozen=True, eq=False)
class FrameFits:
    """Quadratic approximations of the outline terms of N frames, without the session's prior.

    ``poses`` (N, 4, 4) and ``joints`` (N, J), rad, are the points of expansion. ``information`` (N, D, D) is the
    Gauss-Newton matrix and ``slope`` (N, D) the gradient of half the sum of squares there, for changes in each root's
    axes, m and rad; D = 6 + J. The slope is zero at an outline's own optimum.
    """

    poses: Float64
    joints: Float64
    information: Float64
    slope: Float64

    @classmethod
    def of_modes(cls, modes: Sequence[Mode]) -> FrameFits:
        """Take one mode of each frame as a fit with zero slope and the inverse of the mode's covariance."""
        information = np.linalg.inv(np.array([mode.covariance for mode in modes]))
        poses = np.array([mode.camera_from_root for mode in modes])
        joints = np.array([mode.joints for mode in modes])
        return cls(poses, joints, information, np.zeros(information.shape[:2]))

    @cached_property
    def optimum(self) -> Float64:
        """Change (N, D) from the points of expansion to where the outline terms are least; zero where they say nothing.

        The pseudo-inverse leaves out directions that the outline does not determine.
        """
        covariance = np.asarray(np.linalg.pinv(self.information, rcond=1e-9, hermitian=True), dtype=np.float64)
        return -_times(covariance, self.slope)

    def subset(self, index: NDArray[np.integer] | list[int]) -> FrameFits:
        """Return the fits of the frames at some indices."""
        return FrameFits(self.poses[index], self.joints[index], self.information[index], self.slope[index])


@dataclass(frozen=True, eq=False)
class Solution:
    """An estimated calibration with its information matrix (K, K), K = 8 + J, in the order of `SessionModel.axes`.

    ``weights`` (N,) are the robust weights of the frames, ``misfit`` (N,) their squared Mahalanobis distances between
    outline and prediction. ``frame_information`` (N, K, K) and ``frame_slopes`` (N, K) are what each frame adds to the
    information matrix and to the gradient of half the sum of squares at the solution. The frames are in the order they
    were taken.
    """

    calibration: Calibration
    information: Float64
    weights: Float64
    misfit: Float64
    frame_information: Float64
    frame_slopes: Float64

    @cached_property
    def covariance(self) -> Float64:
        """Covariance (K, K) of the calibration, in the order of `SessionModel.axes`.

        Frames that follow each other share errors, of shadows and cables for example, which do not average out as those
        of independent frames do. Standard deviations are therefore at least those that follow from how much the slopes
        of successive parts of the recording scatter (the covariance for clustered errors).
        """
        independent = np.linalg.inv(self.information)
        ratio = np.diag(independent @ scatter(self.frame_slopes) @ independent) / np.diag(independent)
        factor = np.sqrt(np.maximum(ratio, 1.0))
        return np.asarray(factor[:, None] * independent * factor)


@dataclass(frozen=True, eq=False)
class Marginals:
    """N frames after elimination of their poses and joints, at a calibration; all in each root's axes, m and rad.

    ``slope`` (N, D) and ``information`` (N, D, D) are the gradient and the Hessian of half of each frame's sum of
    squares with respect to its prediction. ``misfit`` (N,) is the squared Mahalanobis distance between outline and
    prediction, whose expectation is D if the model holds. ``deviation`` (N, D) and ``covariance`` (N, D, D) are
    mean and covariance of the posterior of each frame's change from its prediction; ``step`` (N, D) is its mean change
    from the point of expansion of the outline, and ``gain`` (N, D, D) the derivative of that by the prediction.
    """

    slope: Float64
    information: Float64
    misfit: Float64
    deviation: Float64
    covariance: Float64
    step: Float64
    gain: Float64


def marginalise(model: SessionModel, fits: FrameFits, calibration: Calibration) -> Marginals:
    """Eliminate the pose and joints of each frame at a calibration."""
    poses, joints = model.predict(calibration)
    predicted = np.concatenate([change_between(fits.poses, poses), joints - fits.joints], axis=1)
    prior = _inverses(model.covariance(calibration))
    covariance = _inverses(fits.information + prior)
    solved = _times(covariance, _times(prior, predicted) - fits.slope)
    information = prior - prior @ covariance @ prior
    difference = predicted - fits.optimum
    # Without information, rounding errors can make the misfit slightly negative.
    misfit = np.maximum((difference * _times(information, difference)).sum(axis=1), 0)
    slope = _times(prior, predicted - solved)
    return Marginals(slope, information, misfit, solved - predicted, covariance, solved, covariance @ prior)


def solve(
    model: SessionModel,
    fits: FrameFits,
    start: Calibration,
    prior: Float64,
    *,
    iterations: int = _ITERATIONS,
) -> Solution:
    """Estimate the calibration by iteratively reweighted Gauss-Newton steps.

    Parameters
    ----------
    model, fits
        The model and the outline fits of the same N frames.
    start
        Calibration of the first linearisation.
    prior : (K, K)
        Information matrix of the prior, whose mean has zero offsets; its rows and columns of the base are zero.
    iterations
        Largest number of steps.
    """
    calibration = start
    dimension = 6 + len(model.names)

    def linearise(at: Calibration) -> tuple[Float64, Float64, Float64, Float64]:
        frames, jacobian = marginalise(model, fits, at), model.jacobian(at)
        weights = robust_weights(frames.misfit, dimension)
        weighted = np.swapaxes(jacobian, 1, 2) * weights[:, None, None]
        frame_information = weighted @ frames.information @ jacobian
        frame_slopes = _times(weighted, frames.slope)
        return weights, frames.misfit, frame_information, frame_slopes

    offset = np.zeros(len(prior))
    for _ in range(iterations):
        weights, misfit, frame_information, frame_slopes = linearise(calibration)
        information = prior + frame_information.sum(axis=0)
        offset[6:] = calibration.offsets
        step = -np.linalg.solve(information, prior @ offset + frame_slopes.sum(axis=0))
        calibration = calibration.changed(step)
        if step @ information @ step < 1e-6 * len(step):
            break
    weights, misfit, frame_information, frame_slopes = linearise(calibration)
    information = prior + frame_information.sum(axis=0)
    return Solution(calibration, information, weights, misfit, frame_information, frame_slopes)


def robust_weights(misfit: Float64, dimension: int) -> Float64:
    """Return the Geman-McClure weights (N,) of frames with some misfits (N,), whose expectation is ``dimension``.

    A frame with the expected misfit has weight 1; smaller weights would make the covariance too large.
    """
    return np.asarray(np.minimum((1 + _ROBUST**-2) / (1 + misfit / (dimension * _ROBUST**2)), 1) ** 2)


def robust_costs(misfit: Float64, dimension: int) -> Float64:
    """Return the robust cost (Geman-McClure) of each of N frames, (N,), whose weights `solve` uses.

    ``misfit`` (N,) are squared Mahalanobis distances, whose expectation is ``dimension`` if the model holds.
    """
    return np.asarray(misfit * (1 + _ROBUST**-2) / (1 + misfit / (dimension * _ROBUST**2)))


def scatter(slopes: Float64) -> Float64:
    """Return the covariance (K, K) of the sum of the slopes (N, K) of frames in the order they were taken.

    It is that of the sums over successive parts of the recording, so errors that frames of a part share count in full.
    """
    sums = np.array([part.sum(axis=0) for part in np.array_split(slopes, min(_PARTS, len(slopes)))])
    return np.atleast_2d(len(sums) * np.cov(sums, rowvar=False))


def leave_one_out(solution: Solution, index: int) -> Calibration:
    """Return the calibration without one frame, by one Gauss-Newton step from the solution with unchanged weights.

    The step is exact if the problem is linear.
    """
    information = solution.information - solution.frame_information[index]
    return solution.calibration.changed(np.linalg.solve(information, solution.frame_slopes[index]))


def _inverses(matrices: Float64) -> Float64:
    """Invert matrices (N, D, D)."""
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64)


def _times(matrices: Float64, vectors: Float64) -> Float64:
    """Multiply matrices (N, D, D) by vectors (N, D)."""
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))


def frame_covariances(model: SessionModel, fits: FrameFits, solution: Solution) -> Float64:
    """Compute the covariance (N, D, D) of each frame's pose and joints, including that of the calibration.

    Axes are the changes of the root's pose in its own axes and the joints, m and rad.
    """
    frames = marginalise(model, fits, solution.calibration)
    jacobian = frames.gain @ model.jacobian(solution.calibration)  # of the frames' estimates
    return np.asarray(frames.covariance + jacobian @ solution.covariance @ np.swapaxes(jacobian, 1, 2))
