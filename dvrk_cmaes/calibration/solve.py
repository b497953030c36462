"""Robust Gauss-Newton estimation of a session's calibration from the outline fits of its frames.

The unknowns of the N frames (D = 6 + J each, pose and joints) are eliminated, so the cost is linear in the number of
frames. What remains are the calibration and, where the outlines are also functions of them, E further unknowns that all
frames share, as of the camera. Frames with large misfits are down-weighted.

The variance components of the readings follow by expectation-maximisation. The expectation step computes the posterior
mean square of each error in each frame. The maximisation step takes its weighted mean over the frames; the configured
initial value counts as ``spread_frames`` further frames. Standard deviations are limited: those of yaw, pitch and
insertion from below and the slack from above by their initial values, and all but the slack from above by multiples of
these. Single large errors of roll or of an instrument's joint (a slipped cable, a reading of another time) are handled
apart from these: the standard deviation of that joint is inflated in that frame only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration, TestedBlock
from dvrk_cmaes.calibration.consensus import INLIER_MISFIT, ArmModes, agreement
from dvrk_cmaes.calibration.model import ROLL, SessionModel
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Bool, Float64, Indices, Posed
from dvrk_cmaes.pose.refine.information import Eliminated, eliminate, times
from dvrk_cmaes.pose.terms.term import Quadratic

_ROBUST = 2.0
"""Scale of the Geman-McClure weights, in expected errors: a frame's weight is 1 up to one and 0.4 at two."""

_SETTLED = 0.25  # standard deviations of the blocks, below which the outlines are not linearised again
_MOST_STEPS = 30  # of an estimation; where weights of outliers fall, it converges slowly

_MODE_ITERATIONS = 5  # largest number of alternations between choosing the frames' modes and solving
_LEAST_EIGENVALUE = 1e-12  # of an information matrix whose diagonal is scaled to 1
_ITERATIONS = 3  # of both estimates
_MAX_ROLL_INFLATION, _MAX_JOINT_INFLATION = 20.0, 2.0
"""Largest factors on standard deviations in single frames; a mask determines the rotation about the shaft least."""
_PARTS = 8  # of a recording, whose errors are taken for independent of each other


@dataclass(frozen=True, eq=False)
class FrameFits:
    """Quadratic approximations of the outline terms of N frames, without the session's prior.

    ``at`` are the N points of expansion. ``outlines`` (N, D + E) are the approximations for changes from there, D = 6 +
    J, and for changes of E further unknowns from the values of their blocks, ``seen``; most often there are none. The
    slope is zero at an outline's own optimum.

    A shadow along the shaft stays for some tenths of a second, and frames near each other share more than that: what
    no joint explains, the readings' errors at one place of the arm, the rest of a segmenter's mistakes. So the errors
    of frames within some time count as those of one, however many they are: else the frames of a recording would
    outweigh the prior, the more of them are used the more. ``shares`` (N,) are those of one frame as which each counts.
    ``by_lag`` (N, D) are the changes of what is predicted of the frames by one standard deviation of the lag.
    """

    at: Posed
    outlines: Quadratic
    shares: Float64
    by_lag: Float64
    seen: Mapping[str, Float64] = field(default_factory=dict)

    @classmethod
    def of_modes(cls, arm: ArmModes, chosen: Indices) -> FrameFits:
        """Take the modes of some numbers (N,) as fits with zero slope and the inverse of the modes' covariances."""
        none = np.zeros(arm.covariances.shape[:2])
        at = arm.mode(np.arange(len(chosen)), chosen)
        information = np.asarray(np.linalg.inv(arm.covariances), np.float64)
        return cls(at, Quadratic(information, none), np.ones(len(chosen)), none)

    @property
    def further(self) -> Float64:
        """Values (E,) of the further unknowns, block after block."""
        return np.concatenate([np.zeros(0), *self.seen.values()])

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


@dataclass(frozen=True, eq=False)
class ArmFrames:
    """N frames of one arm of a session: their model, their fits, and the values of the blocks on which they depend."""

    model: SessionModel
    fits: FrameFits
    calibration: Calibration

    @cached_property
    def eliminated(self) -> Eliminated:
        """The frames without their own poses and joints, which are changes from the points of expansion."""
        predicted = self.model.predict(self.calibration).minus(self.fits.at)
        information = np.asarray(np.linalg.inv(self.model.covariance(self.calibration)), dtype=np.float64)
        return eliminate(self.fits.outlines, predicted, information, self.calibration.further - self.fits.further)

    @property
    def at(self) -> Posed:
        """The N poses and joints at the minimum of outlines and predictions."""
        return self.fits.at.moved(self.eliminated.own)


@dataclass(frozen=True, eq=False)
class Equations:
    """The normal equations of all arms by the G unknowns of the session, of which those that arms share stand once.

    ``places`` are those of each arm's unknowns among them. ``information`` (G, G), ``gradient`` (G,); ``independent``
    (G, G) is the covariance of the gradient if the frames were independent, ``scattered`` (G, G) that by the scatter of
    successive parts of the recording; ``by_lag`` (G,) is the change of the gradient by one standard deviation of the
    lag.
    """

    places: tuple[Indices, ...]
    information: Float64
    gradient: Float64
    independent: Float64
    scattered: Float64
    by_lag: Float64

    def covariance_of(self, inverse: Float64) -> Float64:
        """Return the covariance (G, G) for a given inverse (G, G) of the information, as with something added to it."""
        of_lag = np.outer(self.by_lag, self.by_lag)
        expected = inverse + inverse @ of_lag @ inverse
        others = [np.diag(inverse @ slopes @ inverse) for slopes in (self.independent + of_lag, self.scattered)]
        factor = np.sqrt(np.maximum(np.max(others, axis=0) / np.diag(expected), 1.0))
        return np.asarray(factor[:, None] * expected * factor)


def _places(calibrations: Sequence[Calibration]) -> tuple[tuple[Indices, ...], int]:
    """Return where the unknowns of each arm are among those of the session, and the number of these."""
    found: dict[tuple[int, str], Indices] = {}
    places, count = list[Indices](), 0
    for arm, calibration in enumerate(calibrations):
        keys = {(-1 if block.shared else arm, block.name): len(block.std) for block in calibration.blocks}
        for key, size in keys.items():
            if key not in found:
                found[key] = np.arange(count, count + size)
                count += size
        places.append(np.concatenate([found[key] for key in keys]))
    return tuple(places), count


@dataclass(frozen=True, eq=False)
class Solved(ArmFrames):
    """An arm's part of a solution, by the K unknowns on which its N frames depend; it is number ``arm`` of the session.

    ``weights`` (N,) are the robust weights of the frames, ``misfit`` (N,) their squared Mahalanobis distances between
    outline and prediction, per parameter. ``frame_information`` (N, K, K) and ``frame_slopes`` (N, K) are what each
    frame adds to the information matrix of the ``whole`` and to the gradient of half the sum of squares, less where
    frames count as a share of one.
    """

    weights: Float64
    misfit: Float64
    frame_information: Float64
    frame_slopes: Float64
    whole: Equations
    arm: int

    @property
    def agree(self) -> Bool:
        """Whether each frame agrees with the solution, (N,)."""
        return np.asarray(self.misfit < INLIER_MISFIT)

    @property
    def _place(self) -> tuple[Indices, Indices]:
        place = self.whole.places[self.arm]
        return place[:, None], place

    @cached_property
    def information(self) -> Float64:
        """Information matrix (K, K) of the arm's unknowns, all others eliminated."""
        if len(self.whole.places) == 1:
            return self.whole.information
        return np.asarray(np.linalg.inv(np.linalg.inv(self.whole.information)[self._place]))

    @cached_property
    def covariance(self) -> Float64:
        """Covariance (K, K) of the unknowns, in the order of their steps.

        Frames share errors, which do not average out as those of independent frames do. Those that are near each other
        in time count as one, and that of the lag is the same for all. Standard deviations grow where the slopes of
        successive parts of the recording scatter more than expected (the covariance for clustered errors), as those of
        cables do.
        """
        return self.whole.covariance_of(inverse_information(self.whole.information))[self._place]

    def value(self, name: str) -> Float64:
        """Return the values (n,) of a block of numbers."""
        return np.asarray(self.calibration.values[name])

    @property
    def is_plausible(self) -> bool:
        """Whether the blocks are near enough to where the outlines are linearised."""
        return all(block.is_plausible(self.value(block.name)) for block in self.calibration.tested)

    @property
    def counted(self) -> int:
        """Number of frames whose outlines explain their masks, and count."""
        return int(self.fits.outlines.information.any(axis=(1, 2)).sum())

    @property
    def is_settled(self) -> bool:
        """Whether the blocks are where the outlines are linearised."""
        std, places = np.sqrt(np.diag(self.covariance)), self.calibration.place
        return all(
            (
                np.abs(self.value(one.name) - self.fits.seen[one.name])
                < _SETTLED * np.hypot(std[places(one.name)], one.least_std)
            ).all()
            for one in self.calibration.seen
            if not one.is_linear
        )

    def shown_of(self, block: TestedBlock) -> tuple[Float64, Float64]:
        """Return what the frames show of a block without its prior, where others have theirs: (n,) and (n, n).

        These are its values, and their covariance.
        """
        calibration, more = self.calibration, np.zeros(len(self._place[1]))
        for one in calibration.tested:
            place, std = calibration.place(one.name), one.weak if one.name == block.name else one.known
            more[place] = std**-2.0 - np.diag(calibration.information)[place]
        wider = np.zeros_like(self.whole.information)
        wider[self._place] = np.diag(more)  # of the priors, whose errors are as independent as those of frames
        inverse = inverse_information(self.whole.information + wider)
        values = calibration.changed(-inverse[self._place] @ (more * calibration.deviation)).values[block.name]
        whole = replace(self.whole, independent=self.whole.independent + wider)
        place = calibration.place(block.name)
        return np.asarray(values), whole.covariance_of(inverse)[self._place][place, place]

    def moved_by(self, block: TestedBlock) -> Float64:
        """Return by how much the calibration is off per unit of a block, (L, n), L unknowns that are not tested."""
        own, place = slice(0, self.calibration.own), self.calibration.place(block.name)
        return inverse_information(self.information[own, own]) @ self.information[own, place]


def inverse_information(information: Float64) -> Float64:
    """Invert an information matrix (K, K), which rounding may have left with negative eigenvalues."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    return np.asarray((vectors / np.maximum(values, _LEAST_EIGENVALUE)) @ vectors.T / np.outer(scale, scale))


def solve_arms(arms: Sequence[ArmFrames]) -> list[Solved]:
    """Estimate the calibrations of all arms of a session by iteratively reweighted Gauss-Newton steps.

    Parameters
    ----------
    arms
        The frames of each arm, with the values of its blocks in the first linearisation; blocks that are shared have
        the same values.
    """
    solutions = solution_at(arms)
    for _ in range(_MOST_STEPS):
        whole = solutions[0].whole
        step = -np.asarray(np.linalg.solve(whole.information, whole.gradient), dtype=np.float64)
        changed = [one.calibration.changed(step[place]) for one, place in zip(solutions, whole.places, strict=True)]
        arms = [ArmFrames(arm.model, arm.fits, own) for arm, own in zip(arms, changed, strict=True)]
        solutions = solution_at(arms)
        if step @ whole.information @ step < 1e-6 * len(step):
            break
    return solutions


def solve_with_modes(arm: ArmModes, start: Calibration) -> Solved:
    """Alternate between choosing a mode of each frame and estimating the calibration from these, from a first one."""
    chosen = agreement(arm, start).chosen
    for _ in range(_MODE_ITERATIONS):
        solution = solve_arms([ArmFrames(arm.model, FrameFits.of_modes(arm, chosen), start)])[0]
        before, start = chosen, solution.calibration
        chosen = agreement(arm, start).chosen
        if np.array_equal(chosen, before):
            break
    return solution


def solution_at(arms: Sequence[ArmFrames]) -> list[Solved]:
    """Return the calibrations of arms with what all frames, weighted there, show of them."""
    places, count = _places([arm.calibration for arm in arms])
    prior, deviation, by_lag = np.zeros((count, count)), np.zeros(count), np.zeros(count)
    for arm, place in zip(arms, places, strict=True):
        prior[np.ix_(place, place)], deviation[place] = arm.calibration.information, arm.calibration.deviation
    information, independent, gradient = prior.copy(), prior.copy(), prior @ deviation
    parts, found = np.zeros((_PARTS, count)), list[partial[Solved]]()
    for arm, place in zip(arms, places, strict=True):
        model, fits, calibration, frames = arm.model, arm.fits, arm.calibration, arm.eliminated
        jacobian = model.jacobian(calibration)
        misfit, both = _misfit(frames, fits.optimum(calibration.further)), np.ix_(place, place)
        weights = robust_weights(misfit)
        weighted = np.swapaxes(jacobian, 1, 2) * (fits.shares * weights)[:, None, None]
        of_frames, slopes = weighted @ frames.left.information @ jacobian, times(weighted, frames.left.slope)
        information[both] += of_frames.sum(axis=0)
        independent[both] += np.einsum("n,nij->ij", fits.shares, of_frames)
        gradient[place] += slopes.sum(axis=0)
        by_pose = weighted @ frames.left.information[:, :, : frames.expected.shape[1]]
        by_lag[place] += times(by_pose, fits.by_lag).sum(axis=0)
        for number, part in enumerate(np.array_split(slopes, min(_PARTS, len(slopes)))):
            parts[number, place] += part.sum(axis=0)
        found.append(partial(Solved, model, fits, calibration, weights, misfit, of_frames, slopes))
    used = parts[: max(len(arm.fits.shares) for arm in arms)]
    scattered = np.atleast_2d(len(used) * np.cov(used, rowvar=False))
    whole = Equations(places, information, gradient, independent, scattered, by_lag)
    return [solved(whole, number) for number, solved in enumerate(found)]


def _misfit(frames: Eliminated, optimum: Float64) -> Float64:
    """Return the squared Mahalanobis distances (N,), per parameter, between predictions and outlines' optima (N, D).

    Their expectation is 1 if the model holds.
    """
    difference = frames.expected - optimum
    own = optimum.shape[1]
    squares = (difference * times(frames.left.information[:, :own, :own], difference)).mean(axis=1)
    return np.asarray(np.maximum(squares, 0))  # without information, rounding errors can make them slightly negative


def robust_weights(misfit: Float64) -> Float64:
    """Return the Geman-McClure weights (N,) of frames with some misfits (N,) per parameter.

    A frame with the expected misfit has weight 1; smaller weights would make the covariance too large.
    """
    return np.asarray(np.minimum((1 + _ROBUST**-2) / (1 + misfit / _ROBUST**2), 1) ** 2)


def leave_one_out(solution: Solved, index: int) -> Calibration:
    """Return the calibration without one frame, by one Gauss-Newton step from the solution with unchanged weights.

    The step is exact if the problem is linear.
    """
    information = solution.information - solution.frame_information[index]
    return solution.calibration.changed(np.linalg.solve(information, solution.frame_slopes[index]))


def solve_with_variances(arms: Sequence[ArmFrames], config: SessionConfig) -> list[Solved]:
    """Alternate between estimating the calibrations and the variances of each arm; arguments as in `solve_arms`.

    The models of the solutions have the variances that were estimated last. ``config`` is as in `estimate_variances`.
    """
    for _ in range(_ITERATIONS):
        solutions = [estimate_variances(own, config) for own in solve_arms(arms)]
        arms = solutions
    return solutions


def estimate_variances(solution: Solved, config: SessionConfig) -> Solved:
    """Return a solution whose model has the variances after one iteration of expectation-maximisation.

    Parameters
    ----------
    solution
        The calibration, taken as known, and the robust weights of N frames.
    config
        Limits of the standard deviations, and the weight of their initial values.
    """
    model, frames = solution.model, solution.eliminated
    first, joints, weights = model.usual, len(model.names), solution.weights
    loadings = model.by_errors(solution.calibration) * model.std[:, None]  # of standard normal errors
    gains = np.linalg.solve(model.covariance(solution.calibration), loadings)
    means, spreads = np.einsum("ndk,nd->nk", gains, frames.deviation), frames.covariance @ gains
    squares = means**2 + 1 - (gains * loadings).sum(axis=1) + (gains * spreads).sum(axis=1)
    for alike in (slice(0, 2), slice(-6, -3), slice(-3, None)):  # yaw and pitch, the slack of place and of rotation
        squares[:, alike] = squares[:, alike].mean(axis=1, keepdims=True)
    factors = config.arm_std_factor, config.arm_std_factor / 2, config.cable_std_factor, 1.0
    most = first * np.repeat(factors, [2, 1, 1 + joints, 6])
    total = config.spread_frames * first**2 + weights @ np.minimum(squares * model.deviations**2, most**2)
    values = np.sqrt(total / (config.spread_frames + weights.sum()))
    values[:3] = np.maximum(values[:3], first[:3])
    standardised = np.abs(frames.deviation[:, 5:]) / values[ROLL:-6]
    largest = [_MAX_ROLL_INFLATION] + [_MAX_JOINT_INFLATION] * joints
    inflation = np.clip(standardised / config.tail, 1.0, largest)
    return replace(solution, model=replace(model, deviations=values, inflation=inflation))
