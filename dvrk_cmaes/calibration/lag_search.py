"""Search for the lag between the images and the joint readings of a session, by the modes of its frames.

A wrong lag gives a moving arm readings of another moment, so that the frames' poses no longer agree on one
camera_from_base. The lag is where they agree best. `calibration.session_lag` refines it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration
from dvrk_cmaes.calibration.clock import FARTHEST, RANGE, Clock
from dvrk_cmaes.calibration.consensus import Consensus, Mode, find_consensus
from dvrk_cmaes.calibration.faults import IMPROVEMENT
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number
from dvrk_cmaes.joints.lag import Unit

_LEAST_FRAMES = 6  # of a session; with fewer, a lag cannot be distinguished from outliers
LEAST_AT_LAG = 4  # frames that must have readings at a lag
_LEAST_SHARE = 0.5  # of the frames that must have readings at a lag
_HYPOTHESIS_FRAMES, _TEST_FRAMES = 12, 60  # of each consensus of the search
_TOLD_BY_A_FRAME = 1.25  # degrees of freedom, of 5 of its pose: frames of a recording share errors
UNLIKELY: Final = 1.5
"""Ratio to the least misfit, from which on a lag is unlikely."""
_FLAT = 1.0  # steps of the curve: root mean square of what it allows, from which on it hardly tells a lag
_OF_A_LAG, _OF_NONE = 0.5, 0.7  # of that, least standard deviation of a lag, and of none
_DISAGREE = 2.0  # mean misfit, of at most 4, from which on the frames agree hardly, and a lag is looked for far away
_NOWHERE = 3.0  # mean misfit from which on most frames disagree, and the best lag is one by chance
_COARSE = 3  # steps of the search, in each of the far one: the misfit falls over many times as much
MOVE: Final = "a recording in which the arm moves quickly would determine it"


@dataclass(frozen=True)
class LagCurve(Document):
    """Disagreement of the frames as a function of the lag.

    Each of the ``points`` is a lag in a ``unit``, s or frames, and a misfit: the mean of the frames' squared
    Mahalanobis distances from their consensus by degree of freedom, each at most `INLIER_MISFIT`.
    """

    unit: Unit
    points: tuple[tuple[Number, Number], ...]

    @classmethod
    def of(cls, unit: Unit, lags: Float64, misfit: Float64) -> LagCurve:
        """Return the curve of lags (L,) and their misfits (L,)."""
        return cls(unit, tuple(zip(lags.tolist(), misfit.tolist(), strict=True)))

    @property
    def lags(self) -> Float64:
        """The lags (L,)."""
        return np.array([lag for lag, _ in self.points])

    @property
    def misfit(self) -> Float64:
        """The misfits (L,)."""
        return np.array([misfit for _, misfit in self.points])

    @property
    def against_none(self) -> bool:
        """Whether the frames disagree much more without a lag than at the lag at which they agree best."""
        if len(self.lags) < 3:
            return False
        return bool(self.misfit[np.argmin(np.abs(self.lags))] > UNLIKELY * self.misfit.min())

    @property
    def best(self) -> float:
        """The lag at which the frames agree best, in the curve's unit."""
        return float(self.lags[self.misfit.argmin()])

    @property
    def rivals(self) -> list[float]:
        """The other minima of about the same height, beyond lags that are unlikely, by increasing misfit.

        Motions that repeat themselves have them, a period apart from the lag.
        """
        misfit, found = self.misfit, [int(self.misfit.argmin())]
        inner = range(1, len(misfit) - 1)
        minima = [k for k in inner if misfit[k] <= min(misfit[k - 1], misfit[k + 1], UNLIKELY * misfit.min())]
        for k in sorted(minima, key=lambda k: float(misfit[k])):
            between = [misfit[min(k, other) : max(k, other) + 1].max() for other in found]
            if all(barrier > UNLIKELY * misfit[k] for barrier in between):
                found.append(k)
        return [float(self.lags[k]) for k in found[1:]]

    def root_mean_square(self, frames: int, unknown: float, about: float = 0.0) -> float:
        """Return the root mean square of how far the lags that the curve allows are from one, in its unit.

        Parameters
        ----------
        frames
            Number of frames of which the curve is.
        unknown
            Standard deviation of the lag beforehand, in the unit of the curve. The result is at most the root mean
            square of what is allowed beforehand.
        about
            The lag from which the others are counted.
        """
        told = _TOLD_BY_A_FRAME * frames * (self.misfit - self.misfit.min())
        weights = np.exp(-0.5 * (told + (self.lags / unknown) ** 2))
        return float(min(np.sqrt(weights @ (self.lags - about) ** 2 / weights.sum()), np.hypot(unknown, about)))

    def least_std(self, frames: int, unknown: float, value: float, *, applied: bool) -> float:
        """Return the least standard deviation of a lag, in the unit of the curve: 0 where the curve tells the lag.

        Where the curve is flat, as of few frames that follow each other closely, errors that the frames share displace
        its minimum.

        Parameters
        ----------
        frames
            Number of frames of which the curve is.
        unknown
            Standard deviation of the lag beforehand, in the unit of the curve.
        value
            The lag, in the unit of the curve.
        applied
            Whether it differs from none.
        """
        if len(self.lags) < 2:
            return 0.0
        allowed = self.root_mean_square(frames, unknown, value)
        if allowed <= _FLAT * float(np.diff(self.lags).max()):
            return 0.0
        return allowed * (_OF_A_LAG if applied else _OF_NONE)


@dataclass(frozen=True, eq=False)
class SearchedLag:
    """Result of the search for a lag.

    ``lag`` is to a step of the search, in the unit of the clock, and ``calibration`` is that on which the frames agree
    there; both are None if the search does not determine it, and ``undetermined`` says why. ``curve`` is None if there
    was nothing to search. ``nowhere`` tells that the frames agree at no lag.
    """

    lag: float | None = None
    calibration: Calibration | None = None
    curve: LagCurve | None = None
    undetermined: str = ""
    nowhere: bool = False


def search_lag(clock: Clock, model: SessionModel, modes: Sequence[Sequence[Mode]]) -> SearchedLag:
    """Find the lag at which the frames' modes agree best, and the calibration on which they agree there.

    Where they agree at no lag of the usual range, the far range is searched too. The lag is not determined by too few
    frames, nor if the best lag is at the end of the range, or the frames agree at none. Readings that cannot be
    interpolated must be at regular times, and the lag must halve the mean misfit.
    """
    if len(modes) < _LEAST_FRAMES:
        return SearchedLag(
            undetermined=f"{len(modes)} frames have a pose and readings, at least {_LEAST_FRAMES} are needed"
        )
    step = clock.step
    if step is None:
        return SearchedLag(
            undetermined="the readings are too far apart in time to be interpolated, and at uneven times: give all "
            "rows of the recording, not only those of the frames"
        )

    def searched(low: float, high: float, step: float) -> tuple[Float64, list[Consensus | None], Float64]:
        lags = np.asarray(step * np.arange(round(low / step), round(high / step) + 1), np.float64)
        agreed = [_consensus_at(clock, model, modes, np.array([lag, 0.0])) for lag in lags]
        return lags, agreed, np.array([np.inf if each is None else each.mean_misfit for each in agreed])

    unit, ends = clock.series.unit, tuple[float, ...]()
    low, high = RANGE[unit]
    lags, agreed, costs = searched(low, high, step)
    if clock.interpolable and not costs.min() <= _DISAGREE:
        low, high = -FARTHEST[unit], FARTHEST[unit]
        coarse, _, far = searched(low, high, _COARSE * step)
        if far.min() < costs.min() / UNLIKELY:
            about, ends = float(coarse[far.argmin()]), (low, high)
            lags, agreed, costs = searched(max(low, about - _COARSE * step), min(high, about + _COARSE * step), step)
    curve, best = LagCurve.of(unit, lags[np.isfinite(costs)], costs[np.isfinite(costs)]), int(np.argmin(costs))
    consensus = agreed[best]
    if consensus is None:
        return SearchedLag(curve=curve, undetermined="too few frames have readings at any lag")
    synchronous = int(np.argmin(np.abs(lags)))
    if not clock.interpolable and best != synchronous and costs[best] > IMPROVEMENT * costs[synchronous]:
        return SearchedLag(
            curve=curve,
            undetermined="the readings are too far apart in time to be interpolated, and no lag of whole rows is much "
            "better than none: give all rows of the recording",
        )
    if ends:
        at_end = min(abs(lags[best] - end) for end in ends) < _COARSE * step
        nowhere = at_end or costs[best] > _DISAGREE
    else:
        at_end = best in (0, len(lags) - 1)
        nowhere = bool(costs[best] > _NOWHERE)
    if nowhere:
        return SearchedLag(
            undetermined=f"not determined in the range searched, {low:g} to {high:+g} {unit}: the frames agree at no "
            "lag in it; it may lie beyond (take a first guess out by import --lag, or subtract it from image times)",
            curve=curve,
            nowhere=True,
        )
    if at_end:
        return SearchedLag(
            curve=curve, undetermined=f"the frames agree best at the end of the range that was searched; {MOVE}"
        )
    return SearchedLag(float(lags[best]), consensus.calibration, curve)


def _consensus_at(clock: Clock, model: SessionModel, modes: Sequence[Sequence[Mode]], lag: Float64) -> Consensus | None:
    """Return the consensus of the frames' modes at a lag; None if too few frames have readings there."""
    has = np.flatnonzero(clock.has_readings(lag))
    if len(has) < max(LEAST_AT_LAG, _LEAST_SHARE * len(modes)):
        return None
    return find_consensus(
        clock.model_to_compare(model, lag).subset(has),
        [modes[int(i)] for i in has],
        hypothesis_frames=_HYPOTHESIS_FRAMES,
        test_frames=_TEST_FRAMES,
    )
