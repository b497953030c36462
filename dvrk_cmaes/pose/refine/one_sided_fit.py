"""The pose of a frame whose masks may err on one side of the instrument.

A shadow beside the whole visible shaft makes it look wider, hence closer. The hypotheses of `one_sided` say how a mask
may err; the pose is the mean over all of them, weighted by their probabilities, and its covariance has their scatter.
Errors of the contour are normal and correlated, as in `CorrelatedContour`, so that pose and size of the error of a
hypothesis follow from linear equations, and the probability of the hypothesis in closed form: the size is normal,
restricted to positive values. Which points are outliers is told by the most probable hypothesis, and found in a few
rounds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.refine.information import bounds
from dvrk_cmaes.pose.terms.contour import CLIP, LEAST_POINTS, ContourErrors, robust_sigma
from dvrk_cmaes.pose.terms.one_sided import OneSidedErrors
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Term, sum_of_locals

Float64 = NDArray[np.float64]

_REACH = 12  # px from the outline in which the contour is searched
_FIRST_CLIP = 9.0  # px; larger errors are outliers before any hypothesis has been fitted
_ROUNDS = 4
_OFF_PX, _OFF_SHARE = 1.5, 0.02  # error of the contour, and share of it that a one-sided error makes at least as large
_LARGEST_M, _LARGEST_RAD = 0.03, 0.35  # changes of the pose for which the equations are linear
_TAIL = -8.0  # standard deviations, below which the normal distribution function is its asymptotic series


@dataclass(frozen=True, eq=False)
class OneSidedFit:
    """A pose near another one, with what the hypotheses of one-sided errors say.

    ``plain`` (D,) are the small changes to the pose that is the best one if no error is one-sided, ``shift`` (D,) those
    from there to the mean over the hypotheses, whose scatter is ``spread`` (D, D). ``plain_probability`` is that of no
    error being one-sided, ``sizes`` has the expected size, px, of the error of each hypothesis of each view, zero for
    those that do not hold.
    """

    plain: Float64
    shift: Float64
    spread: Float64
    plain_probability: float
    sizes: tuple[Float64, ...]


@dataclass(frozen=True, eq=False)
class _Contour:
    """The contour of a view near the outline of a pose, and the hypotheses of its one-sided errors."""

    found: ContourErrors
    hypotheses: OneSidedErrors

    def information(self, change: Float64, sizes: Float64, *, first: bool) -> Float64:
        """Return the information about pose, error and sizes, (D + 1 + K, D + 1 + K).

        Points that are outliers after a ``change`` (D,) of the pose and with errors of given ``sizes`` (K,) are left
        out; in the ``first`` round those that no hypothesis explains.
        """
        found, columns = self.found, self.hypotheses.columns
        left = found.errors - found.jacobian @ change - columns @ sizes
        sigma = robust_sigma(left)
        index = np.flatnonzero(np.abs(left) < (_FIRST_CLIP if first else CLIP * sigma))
        right = np.column_stack([found.jacobian[index], found.errors[index], columns[index]])
        usual = np.clip(left[index], -CLIP * sigma, CLIP * sigma)
        return np.asarray(right.T @ found.weighted(index, usual, right))


def fit_one_sided(views: Sequence[SizedView], terms: Sequence[Term], at: Posed) -> OneSidedFit | None:
    """Fit the contours of the views near one pose, with at most one one-sided error in all of them.

    Returns None where a view has too little contour near the outline, where hardly any of it is off, where the changes
    are too large for linear equations, or where the instrument has no shaft.
    """
    contours = []
    for view in views:
        errors = ContourErrors.of(view, at, _REACH)
        contours.append(_Contour(errors, view.one_sided_errors(errors.outline, at)))
        if len(errors) < LEAST_POINTS or not contours[-1].hypotheses.probabilities.size:
            return None
    if all(float(np.mean(np.abs(contour.found.errors) > _OFF_PX)) < _OFF_SHARE for contour in contours):
        return None
    others = sum_of_locals(terms, Posed.stacked([at]))
    dimension, hypotheses = others.dimension, [contour.hypotheses for contour in contours]
    change, sizes = np.zeros(dimension), [np.zeros(len(each.deviations)) for each in hypotheses]
    for number in range(_ROUNDS):
        of_views = [c.information(change, own, first=number == 0) for c, own in zip(contours, sizes, strict=True)]
        of_pose = np.sum([both[:dimension, : dimension + 1] for both in of_views], axis=0)
        information = of_pose[:, :dimension] + others.information[0] + np.diag(bounds(dimension))
        marginal = _marginal(information, of_pose[:, dimension] - others.slope[0], of_views, hypotheses)
        change, sizes = marginal.most_probable()
    found = marginal.summed()
    far = np.abs(found.plain) + np.abs(found.shift)
    return None if far[:3].max() > _LARGEST_M or far[3:].max() > _LARGEST_RAD else found


@dataclass(frozen=True, eq=False)
class _Marginal:
    """The posterior of the pose and of the one-sided errors, of which all views together have K hypotheses.

    ``plain`` (D,) is the change of the pose without any. Of each hypothesis, ``probability`` (K,) is its own,
    ``slopes`` (D, K) are the derivatives of the pose by the size, ``mean`` and ``variance`` (K,), px and px^2, those of
    the size. ``counts`` are the numbers of hypotheses of the views.
    """

    plain: Float64
    probability: Float64
    slopes: Float64
    mean: Float64
    variance: Float64
    counts: list[int]

    def of_views(self, sizes: Float64) -> list[Float64]:
        """Split values (K,) of all hypotheses by view."""
        return np.split(sizes, np.cumsum(self.counts)[:-1])

    def most_probable(self) -> tuple[Float64, list[Float64]]:
        """Return change of the pose and errors of the most probable hypothesis, if one is one-sided at all."""
        sizes = np.zeros_like(self.mean)
        best = int(np.argmax(self.probability))
        if self.probability.sum() > 0.5:
            sizes[best] = self.mean[best]
        return self.plain + self.slopes @ sizes, self.of_views(sizes)

    def summed(self) -> OneSidedFit:
        """Return the mean over all hypotheses."""
        expected = self.probability * self.mean
        shift = self.slopes @ expected
        square = self.probability * (self.variance + self.mean**2)
        spread = (self.slopes * square) @ self.slopes.T - np.outer(shift, shift)
        plain = 1.0 - float(self.probability.sum())
        return OneSidedFit(self.plain, shift, spread, plain, tuple(self.of_views(expected)))


def _marginal(
    information: Float64, slope: Float64, of_views: Sequence[Float64], hypotheses: Sequence[OneSidedErrors]
) -> _Marginal:
    """Return the posterior, from information (D, D) and slope (D,) of the pose and what the views say of the errors."""
    dimension = len(slope)
    errors = [both[dimension + 1 :] for both in of_views]
    cross = np.concatenate([rows[:, :dimension] for rows in errors]).T
    toward = np.concatenate([rows[:, dimension] for rows in errors])
    own = np.concatenate([np.diagonal(rows[:, dimension + 1 :]) for rows in errors])
    deviations = np.concatenate([each.deviations for each in hypotheses])
    before = np.concatenate([each.probabilities for each in hypotheses]) / len(hypotheses)

    solved = np.asarray(np.linalg.solve(information, np.column_stack([slope, cross])), dtype=np.float64)
    plain, slopes = solved[:, 0], -solved[:, 1:]
    precision = own + 1 / deviations**2 + (cross * slopes).sum(axis=0)
    deviation = 1 / np.sqrt(precision)
    best = (toward - plain @ cross) / precision
    mean, variance, mass = _positive(best, deviation)
    odds = np.log(before) + np.log(2 * deviation / deviations) + 0.5 * (best / deviation) ** 2 + mass
    logs = np.concatenate([[np.log(1 - before.sum())], odds])
    probability = np.exp(logs - logs.max())
    probability /= probability.sum()
    return _Marginal(plain, probability[1:], slopes, mean, variance, [len(each.deviations) for each in hypotheses])


def _positive(mean: Float64, deviation: Float64) -> tuple[Float64, Float64, Float64]:
    """Return mean, variance and logarithm of the mass of the positive part of normal distributions (K,)."""
    z = mean / deviation
    mass = np.array([_log_normal_below(value) for value in z.tolist()])
    hazard = np.exp(-0.5 * z**2 - 0.5 * math.log(2 * math.pi) - mass)
    return mean + hazard * deviation, np.maximum(1 - hazard * (hazard + z), 0.0) * deviation**2, mass


def _log_normal_below(z: float) -> float:
    """Return the logarithm of the standard normal distribution function (``scipy.special`` takes 0.1 s to import)."""
    if z > _TAIL:
        return math.log(0.5 * math.erfc(-z / math.sqrt(2)))
    return -0.5 * z * z - math.log(-z * math.sqrt(2 * math.pi)) + math.log1p(-1 / z**2 + 3 / z**4)
