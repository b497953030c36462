"""One calibration from what all frames say: Gauss-Newton over the session's constants, robust over frames.

A frame's own unknowns (pose and joints, 6 + J) are eliminated: with the outline's information H about its solution and
the session's information W = P^-1 about what it expects, the frame pulls at the session with W - W (H + W)^-1 W (the
Schur complement), so that the cost grows linearly with the number of frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.geometry import change_between

Float64 = NDArray[np.float64]

_ROBUST = 2.0  # times the expected error, at which a frame counts two fifths; within that error it counts whole
_ITERATIONS = 30


@dataclass(frozen=True, eq=False)
class FrameViews:
    """What the outlines of N frames say about pose and joints, whatever the session expects.

    Each frame's outline is worth ``information`` (N, D, D) and pulls with ``slope`` (N, D) at ``poses`` (N, 4, 4) and
    ``joints`` (N, J), in each root's axes; D = 6 + J. Where it is best explained, the slope is zero.
    """

    poses: Float64
    joints: Float64
    information: Float64
    slope: Float64

    def subset(self, index: NDArray[np.integer] | list[int]) -> FrameViews:
        """Return some of the frames."""
        return FrameViews(self.poses[index], self.joints[index], self.information[index], self.slope[index])


@dataclass(frozen=True, eq=False)
class Solution:
    """A calibration, its information (K, K), each frame's weight (N,), squared misfit (N,), and own share of both.

    ``shares`` (N, K, K) and ``pulls`` (N, K) are what each frame adds to the information and slope at the solution.
    """

    calibration: Calibration
    information: Float64
    weights: Float64
    misfit: Float64
    shares: Float64
    pulls: Float64

    @property
    def covariance(self) -> Float64:
        """Covariance (K, K) of the calibration, in the model's axes."""
        return np.asarray(np.linalg.inv(self.information))


@dataclass(frozen=True, eq=False)
class _Marginals:
    """Frames without their own unknowns: ``pull`` (N, D) and ``information`` (N, D, D) on what is expected of them."""

    pull: Float64
    information: Float64
    misfit: Float64
    solved: Float64
    covariance: Float64


def marginalise(model: SessionModel, views: FrameViews, calibration: Calibration) -> _Marginals:
    """Eliminate pose and joints of each frame at a calibration.

    ``solved`` (N, D) is each frame's change from what is expected to its best compromise, of ``covariance`` (N, D, D);
    ``misfit`` (N,) the squared misfit between outline and expectation, about D where both are right.
    """
    poses, joints = model.predict(calibration)
    expected = np.concatenate([change_between(views.poses, poses), joints - views.joints], axis=1)
    prior = _inverses(model.covariance(calibration))
    both = _inverses(views.information + prior)
    solved = _times(both, _times(prior, expected) - views.slope)
    information = prior - prior @ both @ prior
    pseudo = np.asarray(np.linalg.pinv(views.information, rcond=1e-9, hermitian=True), dtype=np.float64)
    ideal = -_times(pseudo, views.slope)
    apart = expected - ideal
    misfit = np.maximum(
        np.einsum("ni,nij,nj->n", apart, information, apart), 0
    )  # rounding, of frames that tell nothing
    return _Marginals(_times(prior, expected - solved), information, misfit, solved - expected, both)


def solve(
    model: SessionModel,
    views: FrameViews,
    start: Calibration,
    prior: Float64,
    *,
    iterations: int = _ITERATIONS,
) -> Solution:
    """Fit a calibration to all frames.

    ``prior`` (K, K) is the information about the offsets (and the base, where something is known) before looking.
    """
    calibration = start
    dimension = 6 + len(model.names)

    def linearised(at: Calibration) -> tuple[Float64, Float64, Float64, Float64]:
        frames, rate = marginalise(model, views, at), model.jacobian(at)
        # A frame that is as far off as expected counts whole, or else the calibration would seem less sure than it is.
        weights = np.minimum((1 + _ROBUST**-2) / (1 + frames.misfit / (dimension * _ROBUST**2)), 1) ** 2
        shares = np.einsum("nik,nij,njl,n->nkl", rate, frames.information, rate, weights)
        pulls = np.einsum("nik,ni,n->nk", rate, frames.pull, weights)
        return weights, frames.misfit, shares, pulls

    offset = np.zeros(len(prior))
    for _ in range(iterations):
        weights, misfit, shares, pulls = linearised(calibration)
        information = prior + shares.sum(axis=0)
        offset[6:] = calibration.offsets
        step = -np.linalg.solve(information, prior @ offset + pulls.sum(axis=0))
        calibration = calibration.changed(step)
        if step @ information @ step < 1e-6 * len(step):
            break
    weights, misfit, shares, pulls = linearised(calibration)
    return Solution(calibration, prior + shares.sum(axis=0), weights, misfit, shares, pulls)


def without(solution: Solution, index: int) -> Calibration:
    """Return the calibration that the other frames alone give, to first order (exact where the problem is linear)."""
    information = solution.information - solution.shares[index]
    return solution.calibration.changed(np.linalg.solve(information, solution.pulls[index]))


def _inverses(matrices: Float64) -> Float64:
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64)


def _times(matrices: Float64, vectors: Float64) -> Float64:
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))


def deviations(model: SessionModel, views: FrameViews, solution: Solution) -> Float64:
    """Covariance (N, D, D) of each frame's pose and joints, that of the calibration included, in the root's axes."""
    frames = marginalise(model, views, solution.calibration)
    prior = _inverses(model.covariance(solution.calibration))
    through = frames.covariance @ prior @ model.jacobian(solution.calibration)
    return np.asarray(frames.covariance + through @ solution.covariance @ np.swapaxes(through, 1, 2))
