"""Estimation of the cables' coefficients and wander from uncertain observations of the joints' errors.

The errors c_i (C,) of N poses in the order of time are linear in the coefficients, which are constant, and in the
wander: c_i = F_i x + w_i + noise. Each pose has an observation of c_i with the log-likelihood b_i . c_i - c_i . A_i
c_i / 2, up to a constant. A Kalman filter over the poses gives the likelihood of all observations; the smoother is the
modified Bryson-Frazier one, which inverts no covariance of the state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from dvrk_cmaes.geometry import Float64


@dataclass(frozen=True, eq=False)
class Observations:
    """Observations of the errors of C joints in N poses: ``information`` (N, C, C) and ``vector`` (N, C).

    ``terms`` (N, C, K) are the derivatives of the errors by the K coefficients, ``times`` (N,) s, in order.
    """

    times: Float64
    terms: Float64
    information: Float64
    vector: Float64


@dataclass(frozen=True, eq=False)
class Assumed:
    """What is assumed of coefficients, wander and noise.

    ``mean`` (K,) and ``std`` (K,) are of the coefficients; ``wander`` and ``noise`` (C,) are standard deviations, rad,
    ``seconds`` (C,) the correlation time of the wander.
    """

    mean: Float64
    std: Float64
    wander: Float64
    seconds: Float64
    noise: Float64


@dataclass(frozen=True, eq=False)
class _Step:
    """What the filter leaves of a pose for the smoother; D = K + C is the size of the state.

    ``cross`` (D, C) is the covariance of state and error before the observation, ``design`` (C, D) the derivative of
    the error by the state, ``expected`` (C,) the error and ``spread`` (C, C) its covariance, without the noise.
    ``innovation`` (C,) and ``weight`` (C, C) are the observation's, ``information`` (C, C) and ``vector`` (C,) the
    observation of the error without the noise. ``keep`` (D,) carries the state from the pose before to this one. While
    T assumptions are filtered together, all but the design have a first axis of length T.
    """

    keep: Float64
    design: Float64
    cross: Float64
    expected: Float64
    spread: Float64
    innovation: Float64
    weight: Float64
    information: Float64
    vector: Float64

    def of(self, trial: int) -> _Step:
        """Return the step of one of several assumptions."""
        own = {each.name: getattr(self, each.name)[trial] for each in fields(self) if each.name != "design"}
        return replace(self, **own)


@dataclass(frozen=True, eq=False)
class Filtered:
    """A pass over all poses: the log-likelihood of the observations, and the coefficients given all of them.

    ``mean`` (K,) and ``covariance`` (K, K) are of the coefficients. ``steps`` are of all assumptions that were filtered
    together, of which this is number ``trial``.
    """

    log_likelihood: float
    mean: Float64
    covariance: Float64
    steps: tuple[_Step, ...]
    trial: int


def run_filters(observations: Observations, assumed: Sequence[Assumed]) -> list[Filtered]:
    """Estimate the coefficients, and compute the likelihood of the observations, with each of T assumptions.

    All of them are filtered in one pass: what a pose takes is the number of operations, not their size.
    """
    count, coefficients = observations.terms.shape[1:]
    trials, own = len(assumed), np.eye(count)
    mean = np.array([np.concatenate([one.mean, np.zeros(count)]) for one in assumed])
    covariance = np.array([np.diag(np.concatenate([one.std, one.wander]) ** 2) for one in assumed])
    noise = np.array([np.diag(one.noise**2) for one in assumed])
    wander, seconds = (np.array([getattr(one, name) for one in assumed]) for name in ("wander", "seconds"))
    at = np.arange(coefficients, coefficients + count)
    elapsed = np.diff(observations.times, prepend=observations.times[:1])
    total, steps = np.zeros(trials), []
    for terms, given, vector, wait in zip(
        observations.terms, observations.information, observations.vector, elapsed, strict=True
    ):
        keep = np.concatenate([np.ones((trials, coefficients)), np.exp(-wait / seconds)], axis=1)
        mean = keep * mean
        covariance = keep[:, :, None] * covariance * keep[:, None]
        covariance[:, at, at] += wander**2 * (1 - keep[:, coefficients:] ** 2)
        design = np.concatenate([terms, own], axis=1)
        cross = covariance @ design.T
        expected, spread = mean @ design.T, design @ cross
        total += log_likelihood(given, vector, expected, spread + noise)
        seen = np.linalg.solve(own + given @ noise, np.column_stack([given, vector]))
        information, vector = seen[:, :, :count], seen[:, :, count]
        off = vector - (information @ expected[:, :, None])[:, :, 0]
        gains = np.linalg.solve(own + information @ spread, np.concatenate([information, off[:, :, None]], axis=2))
        weight, innovation = gains[:, :, :count], gains[:, :, count]
        steps.append(_Step(keep, design, cross, expected, spread, innovation, weight, information, vector))
        mean = mean + (cross @ innovation[:, :, None])[:, :, 0]
        covariance = covariance - cross @ weight @ np.swapaxes(cross, 1, 2)
        covariance = (covariance + np.swapaxes(covariance, 1, 2)) / 2
    of = slice(coefficients)
    passes = tuple(steps)
    return [Filtered(float(total[k]), mean[k, of], covariance[k, of, of], passes, k) for k in range(trials)]


def log_likelihood(information: Float64, vector: Float64, expected: Float64, spread: Float64) -> Float64:
    """Return the logs (...) of mean likelihoods of observations over errors with a mean and covariance.

    ``information`` (..., C, C) and ``vector`` (..., C) are of the observations, ``expected`` (..., C) and ``spread``
    (..., C, C) of the errors.
    """
    widened = np.eye(vector.shape[-1]) + spread @ information
    seen = (information @ expected[..., None])[..., 0]
    known = (expected * (vector - seen / 2)).sum(axis=-1)
    off = (vector - seen)[..., None]
    gained = (off * np.linalg.solve(widened, spread @ off)).sum(axis=(-2, -1))
    return np.asarray(known + gained / 2 - np.linalg.slogdet(widened)[1] / 2)


def leave_one_out(filtered: Filtered) -> tuple[Float64, Float64]:
    """Return the mean (N, C) and the covariance (N, C, C) of each pose's error given all other poses.

    The noise is not included.
    """
    steps = [step.of(filtered.trial) for step in filtered.steps]
    means, covariances = [], []
    slope, curvature = np.zeros(len(steps[0].keep)), np.zeros((len(steps[0].keep),) * 2)
    for step in reversed(steps):
        through = np.eye(len(slope)) - step.cross @ step.weight @ step.design
        slope = through.T @ slope - step.design.T @ step.innovation
        curvature = through.T @ curvature @ through + step.design.T @ step.weight @ step.design
        mean = step.expected - step.cross.T @ slope
        covariance = step.spread - step.cross.T @ curvature @ step.cross
        without = np.eye(len(mean)) - covariance @ step.information
        means.append(np.linalg.solve(without, mean - covariance @ step.vector))
        covariances.append(np.linalg.solve(without, covariance))
        slope = step.keep * slope
        curvature = step.keep[:, None] * curvature * step.keep
    stacked = np.array(covariances[::-1])
    return np.array(means[::-1]), (stacked + np.swapaxes(stacked, 1, 2)) / 2
