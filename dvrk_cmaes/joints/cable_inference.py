"""Estimation of the cables' coefficients and wander from uncertain observations of the joints' errors.

The errors c_i (C,) of N poses in the order of time are linear in the coefficients, which are constant, and in the
wander: c_i = F_i x + w_i + noise. Each pose has an observation of c_i with the log-likelihood b_i . c_i - c_i . A_i
c_i / 2, up to a constant. The wander is a Gauss-Markov process of first order, so that the poses form a chain, which is
eliminated from one end to the other; the coefficients, which all poses share, are solved for last.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from dvrk_cmaes import _kernel
from dvrk_cmaes.geometry import Float64, substituted

_LEAST_DRIVE: Final = 1e-9  # variance of the change from a pose to the next one, in that of the wander


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


class Inference:
    """The coefficients and errors given the observations and some assumptions.

    ``log_likelihood`` is that of all observations; ``mean`` (K,) and ``covariance`` (K, K) are of the coefficients
    given all of them.
    """

    def __init__(self, observations: Observations, assumed: Assumed) -> None:
        given, vector, terms = observations.information, observations.vector, observations.terms
        self._terms, self._wander, own = terms, assumed.wander, np.eye(vector.shape[1])
        widened = own + given * assumed.noise**2
        seen = np.linalg.solve(widened, np.concatenate([given, vector[:, :, None]], axis=2))
        self._information, self._vector = information, known = seen[:, :, :-1], seen[:, :, -1]
        # the unknowns of the chain are the wander in its standard deviations, some of which may be zero
        keep = np.exp(-np.diff(observations.times)[:, None] / assumed.seconds)
        drive = np.maximum(1 - keep**2, _LEAST_DRIVE)
        prior = np.concatenate([np.ones((1, len(own))), 1 / drive])
        prior[:-1] += keep**2 / drive
        diagonal = self._wander[:, None] * information * self._wander + prior[:, :, None] * own
        self._coupling = -(keep / drive)[:, :, None] * own
        right = self._wander[:, None] * np.concatenate([known[:, :, None], -information @ terms], axis=2)
        self._pivots, self._sides = _kernel.eliminate_chain(diagonal, self._coupling, right)
        by_chain = np.einsum("nik,nij,njl->kl", self._sides, self._pivots, self._sides, optimize=True)
        precision = np.diag(assumed.std**-2.0)
        left = precision + np.einsum("nik,nij,njl->kl", terms, information, terms, optimize=True) - by_chain[1:, 1:]
        slope = precision @ assumed.mean + np.einsum("nik,ni->k", terms, known) + by_chain[1:, 0]
        self.covariance = np.linalg.inv(left)
        self.mean = self.covariance @ slope
        squares = by_chain[0, 0] + slope @ self.mean - assumed.mean @ precision @ assumed.mean
        squares += float(((vector * known) @ assumed.noise**2).sum())
        logs = np.log(drive).sum() + 2 * np.log(assumed.std).sum() + np.linalg.slogdet(left)[1]
        logs += np.linalg.slogdet(widened)[1].sum() - np.linalg.slogdet(self._pivots)[1].sum()
        self.log_likelihood = float(squares - logs) / 2

    @cached_property
    def left_out(self) -> tuple[Float64, Float64]:
        """The mean (N, C) and the covariance (N, C, C) of each pose's error given all other poses, without noise."""
        wander, blocks = substituted(self._pivots, self._sides, self._coupling)
        wander *= self._wander[:, None]
        change = self._terms + wander[:, :, 1:]
        mean = wander[:, :, 0] + change @ self.mean
        covariance = self._wander[:, None] * blocks * self._wander + change @ self.covariance @ change.swapaxes(1, 2)
        without = np.eye(len(self._wander)) - covariance @ self._information
        off = (mean - np.einsum("nij,nj->ni", covariance, self._vector))[:, :, None]
        found = np.linalg.solve(without, np.concatenate([off, covariance], axis=2))
        return found[:, :, 0], (found[:, :, 1:] + found[:, :, 1:].swapaxes(1, 2)) / 2


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
