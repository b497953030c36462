"""Estimation of the lag between the images and the joint readings of a session.

A wrong lag gives a moving arm readings of another moment, so that the frames' poses no longer agree on one
camera_from_base. The lag is where they agree best, and the curvature of their disagreement there gives its standard
deviation. Clocks that run at different rates make the lag drift; the drift is estimated in the same way, and so is the
lag of the readings of wrist and jaw in addition to that of the outer joints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dvrk_cmaes.calibration.clock import FAR_RANGE, RANGE, Clock, Delay
from dvrk_cmaes.calibration.consensus import Consensus, Mode, find_consensus
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.calibration.solve import FrameFits, Solution, along, alternate, scatter
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number
from dvrk_cmaes.joints.lag import Lag, Unit

_LEAST_FRAMES = 6  # of a session; with fewer, a lag cannot be distinguished from outliers
_LEAST_AT_LAG = 4  # frames that must have readings at a lag
_LEAST_SHARE = 0.5  # of the frames that must have readings at a lag
_HYPOTHESIS_FRAMES, _TEST_FRAMES = 12, 60  # of each consensus of the search
_REFINEMENTS = 4
_MOVES = 6  # of the start of a refinement that leads farther away than half a step of the search
_LEAST_STEP = 0.25  # of the refinement's differences, relative to the search's
_SETTLED = 0.01  # steps of the search, by which a refined value still changes
_IMPROVEMENT = 0.5  # largest ratio of mean misfits at which a lag of readings that cannot be interpolated is applied
_SIGNIFICANT = 2.0  # standard deviations
_LEAST_LAG = 0.3  # frames, below which a lag, or its change in half of the session, is not corrected
_SHARED_ERRORS = 2.0  # factor on the standard deviation: the frames of a recording share errors of masks and readings
_LARGEST_STD = 1.0  # frames, above which the lag is not determined
_DRIFT_STEPS = 4.0  # range of the change of the lag in half of the session, in steps of the search
_DRIFT_STD = 1e-3  # expected beforehand: clocks differ by parts per thousand at most
_TOLD_BY_A_FRAME = 1.25  # degrees of freedom, of 5 of its pose: frames of a recording share errors
_UNLIKELY = 1.5  # ratio to the least misfit, from which on a lag is unlikely
_FLAT = 1.0  # steps of the curve: root mean square of what it allows, from which on it hardly tells a lag
_OF_A_LAG, _OF_NONE = 0.5, 0.7  # of that, least standard deviation of a lag, and of none
_DISAGREE = 2.0  # mean misfit, of at most 4, from which on the frames agree hardly, and a lag is looked for far away
_NOWHERE = 3.0  # mean misfit from which on most frames disagree, and the best lag is one by chance
_COARSE = 3  # steps of the search, in each of the far one: the misfit falls over many times as much
_MOVE = "a recording in which the arm moves quickly would determine it"


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
        return bool(self.misfit[np.argmin(np.abs(self.lags))] > _UNLIKELY * self.misfit.min())

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


@dataclass(frozen=True)
class Refined:
    """A value and its standard deviation, in the unit of the clock."""

    value: float
    std: float


def search_lag(clock: Clock, model: SessionModel, modes: Sequence[Sequence[Mode]], offset_std: Float64) -> SearchedLag:
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

    def searched(low: float, high: float, step: float) -> _Searched:
        lags = step * np.arange(round(low / step), round(high / step) + 1)
        return _Searched(
            np.asarray(lags, np.float64), [_consensus_at(clock, model, modes, offset_std, Delay(lag)) for lag in lags]
        )

    unit = clock.series.unit
    low, high = RANGE[unit]
    near = searched(low, high, step)
    curve = LagCurve.of(unit, near.lags[near.known], near.costs[near.known])
    if clock.interpolable and not near.costs.min() <= _DISAGREE:
        low, high = FAR_RANGE[unit]
        coarse = searched(low, high, _COARSE * step)
        if coarse.costs.min() < near.costs.min() / _UNLIKELY:
            about = float(coarse.lags[coarse.best])
            far = searched(max(low, about - _COARSE * step), min(high, about + _COARSE * step), step)
            curve = LagCurve.of(unit, far.lags[far.known], far.costs[far.known])
            near = replace(far, ends=(low, high))
    best, consensus = near.best, near.agreed[near.best]
    if consensus is None:
        return SearchedLag(curve=curve, undetermined="too few frames have readings at any lag")
    synchronous = int(np.argmin(np.abs(near.lags)))
    if not clock.interpolable and best != synchronous and near.costs[best] > _IMPROVEMENT * near.costs[synchronous]:
        return SearchedLag(
            curve=curve,
            undetermined="the readings are too far apart in time to be interpolated, and no lag of whole rows is much "
            "better than none: give all rows of the recording",
        )
    if near.ends:
        at_end = min(abs(near.lags[best] - end) for end in near.ends) < _COARSE * step
        nowhere = at_end or near.costs[best] > _DISAGREE
    else:
        at_end = best in (0, len(near.lags) - 1)
        nowhere = near.costs[best] > _NOWHERE
    if nowhere:
        return SearchedLag(
            undetermined=f"not told in the range searched, {low:g} to {high:+g} {unit}: the frames agree at no lag in "
            "it; it may lie beyond (take a first guess out by import --lag, or subtract it from the images' times)",
            curve=curve,
            nowhere=True,
        )
    if at_end:
        return SearchedLag(
            curve=curve, undetermined=f"the frames agree best at the end of the range that was searched; {_MOVE}"
        )
    return SearchedLag(float(near.lags[best]), consensus.calibration, curve)


@dataclass(frozen=True, eq=False)
class _Searched:
    """What the frames agree on at some lags (L,); ``ends`` are those of a range of which the lags are a part."""

    lags: Float64
    agreed: Sequence[Consensus | None]
    ends: tuple[float, ...] = ()

    @cached_property
    def costs(self) -> Float64:
        """Mean misfits (L,); infinite where too few frames have readings."""
        return np.array([np.inf if consensus is None else consensus.mean_misfit for consensus in self.agreed])

    @property
    def known(self) -> Bool:
        """Whether enough frames have readings at each lag, (L,)."""
        return np.isfinite(self.costs)

    @property
    def best(self) -> int:
        """Index of the lag at which the frames agree best."""
        return int(np.argmin(self.costs))


def _consensus_at(
    clock: Clock, model: SessionModel, modes: Sequence[Sequence[Mode]], offset_std: Float64, delay: Delay
) -> Consensus | None:
    """Return the consensus of the frames' modes at a lag; None if too few frames have readings there."""
    has = np.flatnonzero(clock.has_readings(delay))
    if len(has) < max(_LEAST_AT_LAG, _LEAST_SHARE * len(modes)):
        return None
    return find_consensus(
        clock.model_to_compare(model, delay).subset(has),
        [modes[int(i)] for i in has],
        offset_std,
        hypothesis_frames=_HYPOTHESIS_FRAMES,
        test_frames=_TEST_FRAMES,
    )


class LagRefiner:
    """Refines a lag, its drift, and the additional lag of wrist and jaw to a fraction of a step of the search.

    Each is an unknown that all frames share, beside the calibration: Gauss-Newton steps take it to where the frames
    agree best. Only frames with readings around it are used.

    Parameters
    ----------
    clock, model, fits
        The clock, the model and the outline fits of the same N frames.
    calibration, prior
        As in `solve`.
    start
        The lag to start from.
    """

    def __init__(
        self, clock: Clock, model: SessionModel, fits: FrameFits, calibration: Calibration, prior: Float64, start: Delay
    ) -> None:
        self.delay = start
        self._clock, self._model, self._fits = clock, model, fits
        self._calibration, self._prior = calibration, prior
        self._step = clock.step or 0.0

    def refine_value(self) -> Refined | None:
        """Refine the lag; None if too few frames have readings, or if the frames agree best nowhere near the start.

        A lag of readings that cannot be interpolated is left as it is.
        """
        if self._step and not self._clock.interpolable:
            return Refined(self.delay.value, float(self._step / np.sqrt(12)))
        refined = self._refined(lambda value: replace(self.delay, value=value), self.delay.value)
        if refined is not None:
            self.delay = replace(self.delay, value=refined.value)
        return refined

    def refine_drift(self) -> Refined | None:
        """Refine the drift; None as in `refine_value`, or if it is not significant or too small to matter."""
        half = self._clock.half_duration
        if half * _DRIFT_STD < _LEAST_LAG * self._clock.series.interval / 4:
            return None
        step, weight = _DRIFT_STEPS * self._step / half, (_SHARED_ERRORS / _DRIFT_STD) ** 2
        drift = self._near(lambda value: replace(self.delay, drift=value), self.delay.drift, step, weight=weight)
        if drift is not None and self._matters(drift, half):
            self.delay = replace(self.delay, drift=drift.value)
            return drift
        self.delay = replace(self.delay, drift=0.0)
        return None

    def _matters(self, drift: Refined, half: float) -> bool:
        """Whether a drift differs significantly from zero and changes the lag noticeably in half of the session."""
        least = _LEAST_LAG * self._clock.series.interval / half
        return abs(drift.value) > max(_SIGNIFICANT * drift.std, least)

    def estimate_joints(self) -> Refined | None:
        """Estimate the lag of the readings of wrist and jaw in addition to that of the outer joints.

        None if its standard deviation exceeds a frame, or if the frames agree best nowhere in the range of the search.
        """
        lag = self._refined(lambda value: replace(self.delay, joints=value), 0.0, lasting=False)
        return None if lag is None or lag.std > _LARGEST_STD * self._clock.series.interval else lag

    def _refined(self, at: Callable[[float], Delay], value: float, *, lasting: bool = True) -> Refined | None:
        """Refine a value in moves of at most half a step of the search; None if it is not settled after some."""
        for _ in range(_MOVES):
            refined = self._near(at, value, self._step, lasting=lasting)
            if refined is None or abs(refined.value - value) < 0.49 * self._step:
                return refined
            value = refined.value
        return None

    def _near(
        self, at: Callable[[float], Delay], start: float, step: float, *, weight: float = 0.0, lasting: bool = True
    ) -> Refined | None:
        """Refine a value that is known to be zero with a weight, at most half a step from the start.

        ``lasting`` errors of cables are those of `Clock.model_to_compare`. None if too few frames have readings a step
        from the start.
        """
        if not (self._clock.interpolable and step > 0):
            return None
        has = self._clock.has_readings(at(start - step)) & self._clock.has_readings(at(start + step))
        if has.sum() < _LEAST_AT_LAG:
            return None
        order = np.flatnonzero(has)[np.argsort(self._clock.times[has], kind="stable")]
        clock, model, fits = self._clock.subset(order), self._model.subset(order), self._fits.subset(order)
        value, curvature, slopes, reach = start, 0.0, np.zeros(len(order)), _LEAST_STEP * step

        def compared(value: float) -> SessionModel:
            return clock.model_to_compare(model, at(value), lasting=lasting)

        def again(there: SessionModel, fits: FrameFits, solution: Solution) -> tuple[SessionModel, FrameFits] | None:
            nonlocal value, curvature, slopes
            later, earlier = (compared(value + by).predict(solution.calibration) for by in (reach, -reach))
            slopes, curvature = along(there, fits, solution, later.minus(earlier) / (2 * reach))
            curvature += weight
            if not curvature > 0:
                return None
            before, moved = value, value - (slopes.sum() + weight * value) / curvature
            value = float(np.clip(moved, start - step / 2, start + step / 2))
            return None if abs(value - before) < _SETTLED * step else (compared(value), fits)

        alternate(compared(start), fits, self._calibration, self._prior, again, _REFINEMENTS)
        if not curvature > 0:
            return None
        alone = _SHARED_ERRORS / float(np.sqrt(curvature))
        return Refined(value, max(alone, float(np.sqrt(scatter(slopes[:, None])[0, 0])) / curvature))


def describe_lag(clock: Clock, lag: Refined, drift: Refined | None = None) -> Lag | str:
    """Decide whether a lag is to be corrected; returns a text that says why where it is not determined."""
    interval = clock.series.interval
    if lag.std > _LARGEST_STD * interval:
        return f"standard deviation {lag.std / interval:.1f} frames; {_MOVE}"
    significant = abs(lag.value) > max(_SIGNIFICANT * lag.std, _LEAST_LAG * interval) or drift is not None
    described = Lag.of(lag.value, lag.std, clock.series.unit, interval, applied=significant)
    if drift is None:
        return described
    return replace(described, drift=drift.value, std_drift=drift.std, middle=clock.middle + clock.series.origin)
