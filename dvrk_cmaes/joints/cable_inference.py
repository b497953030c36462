"""Estimation of the cables' coefficients from uncertain observations of the joints' errors.

The errors c_i (C,) of N poses are linear in the K coefficients x: c_i = F_i x + noise. Each pose has an observation of
c_i with the log-likelihood b_i . c_i - c_i . A_i c_i / 2, up to a constant. So the coefficients, the likelihood of all
observations and what all poses but one show of that one follow from normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.geometry import Float64


@dataclass(frozen=True, eq=False)
class Observations:
    """Observations of the errors of C joints in N poses: ``information`` (N, C, C) and ``vector`` (N, C).

    ``terms`` (N, C, K) are the derivatives of the errors by the K coefficients.
    """

    terms: Float64
    information: Float64
    vector: Float64


@dataclass(frozen=True, eq=False)
class Coefficients:
    """The K coefficients given N observations: their mean and covariance, and the logarithm of the likelihood of all.

    ``normal`` (N, K, K) and ``slopes`` (N, K) are what each pose adds to the normal equations ``whole`` (K, K) and
    ``right`` (K,). ``noise`` (C,) are the standard deviations that were assumed from pose to pose, rad.
    """

    log_likelihood: float
    mean: Float64
    covariance: Float64
    noise: Float64
    normal: Float64
    slopes: Float64
    whole: Float64
    right: Float64

    @classmethod
    def of(cls, given: Observations, mean: Float64, std: Float64, noise: Float64) -> Coefficients:
        """Estimate them from a normal prior with ``mean`` and ``std`` (K,), and with ``noise`` (C,)."""
        count, spread = given.vector.shape[1], np.diag(noise**2)
        both = np.concatenate([given.information, given.vector[:, :, None]], axis=2)
        seen = np.linalg.solve(np.eye(count) + given.information @ spread, both)  # of the errors without the noise
        transposed = np.swapaxes(given.terms, 1, 2)
        normal, slopes = transposed @ seen[:, :, :count] @ given.terms, (transposed @ seen[:, :, count:])[:, :, 0]
        whole, right = np.diag(std**-2.0) + normal.sum(axis=0), std**-2.0 * mean + slopes.sum(axis=0)
        covariance = np.linalg.inv(whole)
        found = covariance @ right
        without = log_likelihood(given.information, given.vector, np.zeros(given.vector.shape), spread).sum()
        gained = found @ right - (mean / std) @ (mean / std) - np.linalg.slogdet(whole)[1] - 2 * np.log(std).sum()
        return cls(float(without + gained / 2), found, covariance, noise, normal, slopes, whole, right)

    def leave_one_out(self, terms: Float64) -> tuple[Float64, Float64]:
        """Return mean (N, C) and covariance (N, C, C) of each pose's error given all other poses, without the noise."""
        left = np.linalg.inv(self.whole - self.normal)
        means = (terms @ left @ (self.right - self.slopes)[:, :, None])[:, :, 0]
        return means, np.asarray(terms @ left @ np.swapaxes(terms, 1, 2))


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
