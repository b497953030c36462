"""Robust Gauss-Newton estimation of a session's calibration from the outline fits of its frames.

The unknowns of the N frames (D = 6 + J each, pose and joints) are eliminated, so the cost is linear in the number of
frames. What remains are the calibration and, where the outlines are also functions of them, E further unknowns that all
frames share, as of the camera. Frames with large misfits are down-weighted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.blocks import Calibration
from dvrk_cmaes.calibration.consensus import Mode, choose_modes
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.lasting_errors import CommonErrors, LastingSlopes, frames_alike, without_lasting
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.pose.refine.elimination import Eliminated, eliminate, times
from dvrk_cmaes.pose.terms.term import Quadratic

_ROBUST = 2.0
"""Scale of the Geman-McClure weights, in expected errors: a frame's weight is 1 up to one and 0.4 at two."""

MOST_STEPS = 30
"""Largest number of steps of an estimation; where weights of outliers fall, it converges slowly."""

_MODE_ITERATIONS = 5  # largest number of alternations between choosing the frames' modes and solving
_PARTS = 8  # of a recording, whose errors are taken for independent of each other


@dataclass(frozen=True, eq=False)
class FrameFits:
    """Quadratic approximations of the outline terms of N frames, without the session's prior.

    ``at`` are the N points of expansion. ``outlines`` (N, D + E) are the approximations for changes from there, D = 6 +
    J, and for changes of E further unknowns from the values of their blocks, ``seen``; most often there are none.
    The slope is zero at an outline's own optimum. ``lasting`` are the changes of these slopes by errors of the masks
    that last from frame to frame, and ``by_lag`` (N, D) the changes of what is predicted by one standard deviation of
    the lag between images and readings; none by default. ``shares`` (N,) are the shares of one frame as which each
    counts, because others err like it; 1 by default.
    """

    at: Posed
    outlines: Quadratic
    seen: Mapping[str, Float64] = field(default_factory=dict)
    lasting: LastingSlopes | None = None
    by_lag: Float64 | None = None
    shares: Float64 | float = 1.0

    @classmethod
    def of_modes(cls, modes: Sequence[Mode]) -> FrameFits:
        """Take one mode of each frame as a fit with zero slope and the inverse of the mode's covariance."""
        information = np.linalg.inv(np.array([mode.covariance for mode in modes]))
        return cls(Posed.stacked(mode.at for mode in modes), Quadratic(information, np.zeros(information.shape[:2])))

    @classmethod
    def of(cls, fits: Sequence[FrameFit]) -> FrameFits:
        """Stack the fits of single frames."""
        outlines = Quadratic(np.array([fit.information for fit in fits]), np.array([fit.slope for fit in fits]))
        return cls(Posed.stacked(fit.at for fit in fits), outlines)

    @classmethod
    def with_lasting(
        cls, at: Posed, terms: Sequence[Quadratic], common: CommonErrors, seen: Mapping[str, Float64] | None = None
    ) -> FrameFits:
        """Stack the outlines' terms of N frames, whose last unknowns are the errors that last, and eliminate these.

        ``common`` are the errors that the frames share; ``seen`` as above.
        """
        seen = {} if seen is None else seen
        own = 6 + at.joints.shape[1] + sum(len(block) for block in seen.values())
        most = max(of_frame.dimension for of_frame in terms)
        stacked = Quadratic.joined([of_frame.padded(most) for of_frame in terms])
        lasting = LastingSlopes.of(stacked, most - own, common.size, common.times)
        outlines = without_lasting(stacked, most - own, common.size)
        counted = stacked.information.any(axis=(1, 2))  # those without an outline are no others beside a frame
        shares = 1 / frames_alike(np.where(counted, common.times, np.nan), common.alike_seconds)
        return cls(at, outlines, seen, lasting, common.by_lag, shares)

    @property
    def further(self) -> Float64:
        """Values (E,) of the further unknowns, block after block."""
        return np.concatenate([np.zeros(0), *self.seen.values()])

    def at_seen(self) -> FrameFits:
        """Return the fits with the further unknowns at their values, as functions of poses and joints alone."""
        own = self.outlines.dimension - len(self.further)
        outlines = Quadratic(self.outlines.information[:, :own, :own], self.outlines.slope[:, :own])
        return FrameFits(self.at, outlines, shares=self.shares)

    def along(self, name: str, values: Float64, effect: Float64) -> FrameFits:
        """Return the fits with a block of n further unknowns that change what is predicted, as the frames' own errors.

        ``values`` (n,) are those at which the predictions are made, ``effect`` (N, D, n) the changes of these by the
        unknowns. Each frame counts as one, and its errors as independent of others.
        """
        across, told = np.swapaxes(effect, 1, 2), self.outlines.information @ effect
        information = np.block([[self.outlines.information, told], [np.swapaxes(told, 1, 2), across @ told]])
        slope = np.concatenate([self.outlines.slope, times(across, self.outlines.slope)], axis=1)
        return FrameFits(self.at, Quadratic(information, slope), {name: values})

    def optimum(self, further: Float64) -> Float64:
        """Return the change (N, D) from the points of expansion to where the outline terms are least.

        It is zero in directions that the outline does not determine. ``further`` (E,) are the further unknowns.
        """
        own = self._own_covariance.shape[1]
        cross = self.outlines.information[:, :own, own:]
        return -times(self._own_covariance, self.outlines.slope[:, :own] + cross @ (further - self.further))

    @cached_property
    def _own_covariance(self) -> Float64:
        """Pseudo-inverse (N, D, D) of the outlines' information, without directions that it does not determine."""
        own = self.outlines.dimension - len(self.further)
        information = self.outlines.information[:, :own, :own]
        return np.asarray(np.linalg.pinv(information, rcond=1e-9, hermitian=True), dtype=np.float64)

    def subset(self, index: list[int] | NDArray[np.integer]) -> FrameFits:
        """Return the fits of the frames at some indices."""
        lasting = None if self.lasting is None else self.lasting.subset(index)
        by_lag = None if self.by_lag is None else self.by_lag[index]
        outlines = self.outlines.select([int(i) for i in index])
        shares = np.broadcast_to(self.shares, len(self.at))[index]
        return FrameFits(self.at[index], outlines, self.seen, lasting, by_lag, shares)


@dataclass(frozen=True, eq=False)
class Solved:
    """An estimated calibration with its information matrix (K, K), K = 8 + J + E, in the order of its steps.

    ``weights`` (N,) are the robust weights of the frames, ``misfit`` (N,) their squared Mahalanobis distances between
    outline and prediction. ``frame_information`` (N, K, K) and ``frame_slopes`` (N, K) are what each frame adds to the
    information matrix and to the gradient of half the sum of squares at the solution, less where frames count as a
    share of one. The frames are in the order they were taken. ``independent`` (K, K) is the covariance of the sum of
    these gradients and of the prior's if the frames were independent; it is the information matrix where each counts as
    one. ``lasting`` are the changes of the gradients by errors of the masks that last from frame to frame, ``by_lag``
    (K,) is the change of their sum by one standard deviation of the lag. ``of_growth`` (K, K) is the mean square of the
    errors that errors of all masks on some sides cause; None where these are not known.
    """

    calibration: Calibration
    information: Float64
    weights: Float64
    misfit: Float64
    frame_information: Float64
    frame_slopes: Float64
    independent: Float64
    lasting: LastingSlopes
    by_lag: Float64
    of_growth: Float64 | None = None

    @cached_property
    def covariance(self) -> Float64:
        """Covariance (K, K) of the calibration, in the order of its steps.

        Frames share errors, which do not average out as those of independent frames do. Those that are near each other
        in time count as one, and that of the lag is the same for all. Standard deviations grow where more is expected
        of the errors of the masks that last from frame to frame, with their correlation, and where the slopes of
        successive parts of the recording scatter more (the covariance for clustered errors), as those of cables do.
        """
        alone = self.covariance_of(np.asarray(np.linalg.inv(self.information), dtype=np.float64))
        return alone if self.of_growth is None else alone + self.of_growth

    def covariance_of(self, inverse: Float64) -> Float64:
        """Return the covariance for a given inverse (K, K) of the information, as of a matrix with something added."""
        of_lag = np.outer(self.by_lag, self.by_lag)
        lasting = self.independent + self.lasting.between_frames + of_lag
        expected = inverse + inverse @ of_lag @ inverse
        others = [np.diag(inverse @ slopes @ inverse) for slopes in (lasting, scatter(self.frame_slopes))]
        factor = np.sqrt(np.maximum(np.max(others, axis=0) / np.diag(expected), 1.0))
        return np.asarray(factor[:, None] * expected * factor)


def marginalise(model: SessionModel, fits: FrameFits, calibration: Calibration) -> Eliminated:
    """Eliminate the pose and joints of each frame at a calibration; they are changes from the points of expansion."""
    predicted = model.predict(calibration).minus(fits.at)
    information = np.asarray(np.linalg.inv(model.covariance(calibration)), dtype=np.float64)
    return eliminate(fits.outlines, predicted, information, calibration.further - fits.further)


Solver = Callable[[SessionModel, FrameFits, Calibration], tuple[SessionModel, Solved]]
"""Estimates a calibration from a model, fits and a start, as `solve`; the model may change."""


def solve(model: SessionModel, fits: FrameFits, start: Calibration, *, steps: int = MOST_STEPS) -> Solved:
    """Estimate the calibration by iteratively reweighted Gauss-Newton steps.

    Parameters
    ----------
    model, fits
        The model and the outline fits of the same N frames.
    start
        Calibration of the first linearisation, with the blocks that the fits have, and their prior.
    steps
        Largest number of steps.
    """
    solution, prior = solution_at(model, fits, start), start.information
    for _ in range(steps):
        information, at = solution.information, solution.calibration.deviation
        step = -np.linalg.solve(information, prior @ at + solution.frame_slopes.sum(axis=0))
        solution = solution_at(model, fits, solution.calibration.changed(step))
        if step @ information @ step < 1e-6 * len(step):
            break
    return solution


def cost_at(model: SessionModel, fits: FrameFits, calibration: Calibration, weights: Float64) -> float:
    """Return the sum of squares of a calibration's frames, with given weights (N,), and of the prior.

    It is that where the frames' own unknowns are best, up to a constant; the other arguments are as in `solve`.
    """
    own, outlines = fits.at.joints.shape[1] + 6, fits.outlines
    predicted, constants = model.predict(calibration).minus(fits.at), calibration.further - fits.further
    known = np.asarray(np.linalg.inv(model.covariance(calibration)), dtype=np.float64)
    of_own, cross = outlines.information[:, :own, :own] + known, outlines.information[:, :own, own:]
    pulled = times(known, predicted) - outlines.slope[:, :own] - cross @ constants
    squares = (predicted * times(known, predicted)).sum(axis=1)
    squares += (constants * (outlines.information[:, own:, own:] @ constants + 2 * outlines.slope[:, own:])).sum(axis=1)
    squares -= (pulled * np.linalg.solve(of_own, pulled[:, :, None])[:, :, 0]).sum(axis=1)
    at, shares = calibration.deviation, np.broadcast_to(fits.shares, len(weights))
    return float((shares * weights) @ squares + at @ calibration.information @ at)


def solve_unchanged(model: SessionModel, fits: FrameFits, start: Calibration) -> tuple[SessionModel, Solved]:
    """Estimate the calibration as `solve`, and return the model as it was, too."""
    return model, solve(model, fits, start)


def solve_with_modes(model: SessionModel, modes: Sequence[Sequence[Mode]], start: Calibration) -> Solved:
    """Alternate between choosing a mode of each frame and estimating the calibration from these.

    Arguments are as in `choose_modes` and `solve`.
    """
    chosen = choose_modes(model, modes, start)
    for _ in range(_MODE_ITERATIONS):
        solution = solve(model, FrameFits.of_modes(chosen), start)
        before, start = chosen, solution.calibration
        chosen = choose_modes(model, modes, start)
        if all(one is other for one, other in zip(chosen, before, strict=True)):
            break
    return solution


def solution_at(model: SessionModel, fits: FrameFits, calibration: Calibration) -> Solved:
    """Return a calibration with what the frames, weighted there, tell of it; arguments as in `solve`."""
    frames, jacobian = marginalise(model, fits, calibration), model.jacobian(calibration)
    misfit = _misfit(frames, fits.optimum(calibration.further))
    weights = robust_weights(misfit, 6 + len(model.names))
    shares = np.broadcast_to(fits.shares, len(weights))
    weighted = np.swapaxes(jacobian, 1, 2) * (shares * weights)[:, None, None]
    frame_information = weighted @ frames.left.information @ jacobian
    frame_slopes = times(weighted, frames.left.slope)
    prior = calibration.information
    information = prior + frame_information.sum(axis=0)
    independent = prior + np.einsum("n,nij->ij", shares, frame_information)
    lasting, own = _of_calibration(fits, frames, weighted), fits.outlines.dimension - len(fits.further)
    by_lag = np.zeros(len(information))
    if fits.by_lag is not None:
        by_lag = times(weighted @ frames.left.information[:, :, :own], fits.by_lag).sum(axis=0)
    return Solved(
        calibration, information, weights, misfit, frame_information, frame_slopes, independent, lasting, by_lag
    )


def _of_calibration(fits: FrameFits, frames: Eliminated, weighted: Float64) -> LastingSlopes:
    """Return what lasting errors do to the slopes by the calibration, (N, K), of frames whose own unknowns are gone.

    ``weighted`` (N, K, D + E) are the transposed Jacobians of the predictions, times the frames' weights.
    """
    if fits.lasting is None:
        return LastingSlopes.none(*weighted.shape[:2])
    own = fits.outlines.dimension - len(fits.further)
    to_left = np.swapaxes(frames.gain, 1, 2)
    of_further = np.zeros((*to_left.shape[:2], len(fits.further)))
    of_further[:, own:] = np.eye(len(fits.further))
    return fits.lasting.mapped(weighted @ np.concatenate([to_left, of_further], axis=2))


def _misfit(frames: Eliminated, optimum: Float64) -> Float64:
    """Return the squared Mahalanobis distances (N,) between predictions and the outlines' own optima (N, D).

    Their expectation is D if the model holds.
    """
    difference = frames.expected - optimum
    own = optimum.shape[1]
    squares = (difference * times(frames.left.information[:, :own, :own], difference)).sum(axis=1)
    return np.asarray(np.maximum(squares, 0))  # without information, rounding errors can make them slightly negative


def robust_weights(misfit: Float64, dimension: int) -> Float64:
    """Return the Geman-McClure weights (N,) of frames with some misfits (N,), whose expectation is ``dimension``.

    A frame with the expected misfit has weight 1; smaller weights would make the covariance too large.
    """
    return np.asarray(np.minimum((1 + _ROBUST**-2) / (1 + misfit / (dimension * _ROBUST**2)), 1) ** 2)


def scatter(slopes: Float64) -> Float64:
    """Return the covariance (K, K) of the sum of the slopes (N, K) of frames in the order they were taken.

    It is that of the sums over successive parts of the recording, so errors that frames of a part share count in full.
    """
    sums = np.array([part.sum(axis=0) for part in np.array_split(slopes, min(_PARTS, len(slopes)))])
    return np.atleast_2d(len(sums) * np.cov(sums, rowvar=False))


def leave_one_out(solution: Solved, index: int) -> Calibration:
    """Return the calibration without one frame, by one Gauss-Newton step from the solution with unchanged weights.

    The step is exact if the problem is linear.
    """
    information = solution.information - solution.frame_information[index]
    return solution.calibration.changed(np.linalg.solve(information, solution.frame_slopes[index]))


def frame_covariances(model: SessionModel, fits: FrameFits, solution: Solved) -> Float64:
    """Compute the covariance (N, D, D) of each frame's pose and joints, including that of the calibration.

    Axes are the changes of the root's pose in its own axes and the joints, m and rad.
    """
    frames = marginalise(model, fits, solution.calibration)
    jacobian = frames.gain @ model.jacobian(solution.calibration)  # of the frames' estimates
    return np.asarray(frames.covariance + jacobian @ solution.covariance @ np.swapaxes(jacobian, 1, 2))
