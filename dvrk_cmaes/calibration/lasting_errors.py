"""Errors of masks that last from frame to frame, and what they do to a session's calibration.

A shadow beside the shaft stays for some tenths of a second. The errors of both sides of the shaft as a whole are
therefore Ornstein-Uhlenbeck processes: normal, with standard deviations in proportion to those of
`dvrk_cmaes.pose.terms.shared_errors`, and a correlation of exp(-dt / T) between frames that are dt apart. A calibration
takes the frames as independent, which makes it hardly less accurate, but its covariance counts the correlation.

Frames near each other share more than that: what no joint explains, the readings' errors at one place of the arm,
the rest of a segmenter's mistakes. Those of half a second (`SessionConfig.alike_seconds`) therefore count as one,
however many they are: else the frames of a recording would outweigh what is known beforehand, the more of them are used
the more, and the result would be stated better than it is.

The usual size is that at the true poses of followed recordings, three hard and one easy one: standard deviations of 0.2
to 0.6 of those of single frames, whose loss is less robust against shadows, and autocorrelations of 0.3 to 0.6 after
0.1 s, 0 to 0.4 after 0.3 s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.pose.terms.shared_errors import without_last
from dvrk_cmaes.pose.terms.term import Quadratic

CORRELATED_FRAMES = 3.0
"""Frames near each other whose masks err alike: what each tells counts as much less beside its neighbours."""
_AT_ONE_TIME = 0.999  # correlation of the errors of frames of one time


@dataclass(frozen=True)
class LastingSize:
    """Size of the errors that last: factor on their standard deviations in single frames, and correlation time, s."""

    scale: float
    seconds: float

    def correlation(self, times: Float64) -> Float64:
        """Return the correlations (N, N) of the errors of frames at some times, s; without times (NaN), they differ.

        Frames of one time have all but the same errors: less than 1, so that the matrix stays definite.
        """
        apart = np.abs(times[:, None] - times)
        correlation = np.exp(-np.where(np.isnan(apart), np.inf, apart) / self.seconds)
        correlation[apart == 0] = _AT_ONE_TIME
        np.fill_diagonal(correlation, 1.0)
        return np.asarray(correlation)


USUAL_SIZE = LastingSize(0.4, 0.2)
"""Size of the errors that last in a session's fits where nothing else is known."""

SINGLE_SIZE = LastingSize(1.0, 0.2)
"""Size of the errors that last in frames that count as independent although they follow each other closely."""


@dataclass(frozen=True, eq=False)
class CommonErrors:
    """Errors that N frames share: of the masks, those that last from frame to frame, and of the lag.

    ``size`` is that of the masks' errors, ``times`` (N,), s, are those of the frames, NaN where unknown. ``by_lag``
    (N, D) are the changes of what is predicted of the frames by one standard deviation of the lag. Frames within
    ``alike_seconds`` err alike, and count as one.
    """

    size: LastingSize
    times: Float64
    by_lag: Float64
    alike_seconds: float = 0.0

    @classmethod
    def none(cls, frames: int, dimension: int) -> CommonErrors:
        """Return those of N frames, of D unknowns each, that err each by itself."""
        return cls(SINGLE_SIZE, np.full(frames, np.nan), np.zeros((frames, dimension)))

    def subset(self, index: Sequence[int] | NDArray[np.integer]) -> CommonErrors:
        """Return those of the frames at some indices."""
        return replace(self, times=self.times[index], by_lag=self.by_lag[index])


def frames_alike(times: Float64, seconds: float) -> Float64:
    """Return the number of frames (N,), itself included, that err like each frame and count as one with it.

    Parameters
    ----------
    times : (N,)
        Times of the frames, s; frames without one (NaN) count by themselves.
    seconds
        Time in which frames err alike.
    """
    known, out = np.isfinite(times), np.ones(len(times))
    in_order, half = np.sort(times[known]), seconds / 2
    first = np.searchsorted(in_order, times[known] - half, side="left")
    out[known] = np.searchsorted(in_order, times[known] + half, side="right") - first
    return out


@dataclass(frozen=True, eq=False)
class LastingSlopes:
    """Changes of the slopes of N frames by S lasting errors.

    ``loadings`` (N, K, S) are the changes by a standard deviation of each error, ``correlation`` (N, N) is that of the
    errors of two frames.
    """

    loadings: Float64
    correlation: Float64

    @classmethod
    def of(cls, terms: Quadratic, count: int, size: LastingSize, times: Float64) -> LastingSlopes:
        """Return the changes of slopes from which ``count`` lasting errors, the last of terms (N, K + S), are gone."""
        own = terms.dimension - count
        cross, of_errors = terms.information[:, :own, own:], terms.information[:, own:, own:]
        known = np.eye(count) / size.scale**2
        return cls(cross @ np.linalg.inv(of_errors + known) / size.scale, size.correlation(times))

    @classmethod
    def none(cls, frames: int, dimension: int) -> LastingSlopes:
        """Return those of frames without lasting errors."""
        return cls(np.zeros((frames, dimension, 0)), np.eye(frames))

    def subset(self, index: Sequence[int] | NDArray[np.integer]) -> LastingSlopes:
        """Return those of the frames at some indices."""
        return LastingSlopes(self.loadings[index], self.correlation[index][:, index])

    def mapped(self, matrices: Float64) -> LastingSlopes:
        """Return those of slopes (N, K') that are linear in these, by matrices (N, K', K)."""
        return LastingSlopes(matrices @ self.loadings, self.correlation)

    @property
    def between_frames(self) -> Float64:
        """Covariance (K, K) that the sum of the slopes has more than that of independent frames has."""
        frames, dimension, count = self.loadings.shape
        with_others = (self.correlation - np.eye(frames)) @ self.loadings.reshape(frames, -1)
        covariance = np.einsum("nks,nls->kl", self.loadings, with_others.reshape(frames, dimension, count))
        return np.asarray(covariance, dtype=np.float64)


def without_lasting(terms: Quadratic, count: int, size: LastingSize) -> Quadratic:
    """Eliminate ``count`` lasting errors, the last of terms (N, K + S): to (N, K)."""
    return without_last(terms, np.eye(count) / size.scale**2)
