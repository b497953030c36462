"""Estimation of the cables' coefficients and wander from uncertain observations of the joints' errors.

The errors c_i (C,) of N poses in the order of time are linear in the coefficients, which are constant, and in the
wander: c_i = F_i x + w_i + noise. Each pose has an observation of c_i with the log-likelihood b_i . c_i - c_i . A_i
c_i / 2, up to a constant. A Kalman filter over the poses gives the likelihood of all observations; the smoother is the
modified Bryson-Frazier one, which inverts no covariance of the state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


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
    observation of the error without the noise. ``keep`` (D,) carries the state from the pose before to this one.
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


@dataclass(frozen=True, eq=False)
class Filtered:
    """A pass over all poses: the log-likelihood of the observations, and the coefficients given all of them.

    ``mean`` (K,) and ``covariance`` (K, K) are of the coefficients.
    """

    log_likelihood: float
    mean: Float64
    covariance: Float64
    steps: tuple[_Step, ...]


def run_filter(observations: Observations, assumed: Assumed) -> Filtered:
    """Estimate the coefficients, and compute the likelihood of the observations."""
    count, coefficients = observations.terms.shape[1:]
    mean = np.concatenate([assumed.mean, np.zeros(count)])
    covariance = np.diag(np.concatenate([assumed.std, assumed.wander]) ** 2)
    noise, own = np.diag(assumed.noise**2), np.eye(count)
    wander = np.diag(covariance)[coefficients:].copy()
    at = np.arange(coefficients, coefficients + count)
    elapsed = np.diff(observations.times, prepend=observations.times[:1])
    total, steps = 0.0, []
    for terms, given, vector, wait in zip(
        observations.terms, observations.information, observations.vector, elapsed, strict=True
    ):
        keep = np.concatenate([np.ones(coefficients), np.exp(-wait / assumed.seconds)])
        mean = keep * mean
        covariance = keep[:, None] * covariance * keep
        covariance[at, at] += wander * (1 - keep[coefficients:] ** 2)
        design = np.concatenate([terms, own], axis=1)
        cross = covariance @ design.T
        expected, spread = design @ mean, design @ cross
        total += log_likelihood(given, vector, expected, spread + noise)
        seen = np.linalg.solve(own + given @ noise, np.column_stack([given, vector]))
        information, told = seen[:, :count], seen[:, count]
        gains = np.linalg.solve(
            own + information @ spread, np.column_stack([information, told - information @ expected])
        )
        weight, innovation = gains[:, :count], gains[:, count]
        steps.append(_Step(keep, design, cross, expected, spread, innovation, weight, information, told))
        mean = mean + cross @ innovation
        covariance = covariance - cross @ weight @ cross.T
        covariance = (covariance + covariance.T) / 2
    return Filtered(total, mean[:coefficients], covariance[:coefficients, :coefficients], tuple(steps))


def log_likelihood(information: Float64, vector: Float64, expected: Float64, spread: Float64) -> float:
    """Return the log of the mean likelihood of an observation over errors with a mean (C,) and covariance (C, C)."""
    widened = np.eye(len(vector)) + spread @ information
    off = vector - information @ expected
    known = expected @ (vector - information @ expected / 2)
    return float(known + off @ np.linalg.solve(widened, spread @ off) / 2 - np.linalg.slogdet(widened)[1] / 2)


def leave_one_out(filtered: Filtered) -> tuple[Float64, Float64]:
    """Return the mean (N, C) and the covariance (N, C, C) of each pose's error given all other poses.

    The noise is not included.
    """
    steps = filtered.steps
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
