"""The lag of the images behind the readings, which all frames of a session share.

It is found from the frames' own modes, by which the readings of each frame are chosen. From then on it is a block of
unknowns beside base and offsets, in one linearised problem: a change of the lag changes what is predicted of a frame by
the velocity of its readings. Clocks that run at different rates make the lag drift; the drift is estimated with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np

from dvrk_cmaes.calibration.blocks import Block, Calibration
from dvrk_cmaes.calibration.clock import FARTHEST, Clock
from dvrk_cmaes.calibration.consensus import Mode, choose_modes
from dvrk_cmaes.calibration.lag_search import LEAST_AT_LAG, MOVE, LagCurve, search_lag
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.solve import FrameFits, solve
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.play import Play
from dvrk_cmaes.joints.series import ReadingSeries

_LAG, _DRIFT = range(2)  # of the values of a lag, as of `Clock`
_WHOLE = np.eye(2)[_LAG]
_DRIFT_STD = 1e-3  # expected beforehand: clocks differ by parts per thousand at most
_SHARED_ERRORS = 2.0  # factor on the standard deviation: the frames of a recording share errors of masks and readings
_LINEARISATIONS, _MOST_LINEARISATIONS = 4, 10  # those that do not move the lag by half a step of the search, and all
_DRIFT_STEPS = 4.0  # range of the change of the lag in half of the session, in steps of the search
_LEAST_STEP = 0.25  # of the refinement's differences, relative to the search's
_SETTLED, _SETTLING = 0.01, 0.45  # steps of the search, by which a refined value still changes, and by which at most
_SIGNIFICANT = 2.0  # standard deviations
_LEAST_LAG = 0.3  # frames, below which a lag, or its change in half of the session, is not corrected
_LARGEST_STD = 1.0  # frames, above which the lag is not determined
_UNDETERMINED = 2.0  # frames, least standard deviation of a lag that is not determined, and ...
_UNKNOWN = 3.0  # ... largest
NO_READINGS_AT_LAG: Final = "no readings once the lag is taken out"
"""Why a frame is left out."""
POSTURES: Final = (
    "the rows have no times, and readings jump from row to row, as those of postures: none is looked for unless --lag "
    "auto asks for it; give times of a recording"
)
"""Why no lag is looked for."""
_AGREE = 3.0  # standard deviations of each lag, within which those of several arms are taken for one


class FramesOfLag(NamedTuple):
    """What tells the lag of N frames: their clock, model and fits, and a calibration, as in `solve`."""

    clock: Clock
    model: SessionModel
    fits: FrameFits
    calibration: Calibration


def refine_lag(frames: FramesOfLag, start: Float64, free: tuple[int, ...] = (_LAG,)) -> tuple[Float64, Float64] | None:
    """Refine some values of a lag together with the calibration; returns all, with standard deviations (2,) of these.

    Only frames with readings around the lag are used. None if too few have them, if the frames agree best nowhere near
    the start, or if the readings cannot be interpolated.

    Parameters
    ----------
    frames
        The frames.
    start : (2,)
        The lag to start from, as of `Clock`.
    free
        Which values are unknowns.
    """
    clock, own = frames.clock, list(free)
    step, far = clock.step, FARTHEST[clock.series.unit]
    if not clock.interpolable or not step:
        return None
    reach = np.array([step, _DRIFT_STEPS * step / max(clock.half_duration, step)])[own]
    known = np.array([far, _DRIFT_STD])[own] / _SHARED_ERRORS
    lag, left, linearised = start, _LINEARISATIONS, _near_lag(frames, start, own, reach, frames.calibration)
    if linearised is None:
        return None
    calibration = frames.calibration.beside(Block("lag", known), **linearised[1].seen)
    for _ in range(_MOST_LINEARISATIONS):
        model, fits = linearised
        solution = solve(model, fits, calibration)
        calibration = solution.calibration
        change = np.clip(calibration.further - fits.further, -reach / 2, reach / 2)
        lag, moved = start.copy(), np.abs(change) / reach
        lag[own] = fits.further + change
        left -= int((moved < 0.5).all())
        linearised = None if not left or (moved < _SETTLED).all() else _near_lag(frames, lag, own, reach, calibration)
        if linearised is None:
            break
    if (moved > _SETTLING).any():
        return None
    inverse, std = np.asarray(np.linalg.inv(solution.information)), np.zeros(2)
    alone, shared = _SHARED_ERRORS**2 * np.diag(inverse), np.diag(solution.covariance_of(inverse))
    std[own] = np.sqrt(np.maximum(alone, shared))[-len(own) :]
    return lag, std


def _near_lag(
    frames: FramesOfLag, lag: Float64, own: list[int], reach: Float64, calibration: Calibration
) -> tuple[SessionModel, FrameFits] | None:
    """Linearise what a calibration predicts of the frames at a lag (2,) in those ``own`` values that are unknowns.

    ``reach`` (n,) are the largest changes of these; None if too few frames have readings there.
    """
    clock, rows = frames.clock, reach[:, None] * np.eye(2)[own]
    has = np.logical_and.reduce([clock.has_readings(lag + by) for by in (*rows, *-rows)])
    if has.sum() < LEAST_AT_LAG:
        return None
    order = np.flatnonzero(has)[np.argsort(clock.times[has], kind="stable")]
    of_these, model, fits = clock.subset(order), frames.model.subset(order), frames.fits.subset(order)
    changes = []
    for row in _LEAST_STEP * rows:
        later, earlier = (of_these.model_to_compare(model, lag + by).predict(calibration) for by in (row, -row))
        changes.append(later.minus(earlier))
    effect = np.stack(changes, axis=2) / (2 * _LEAST_STEP * reach)
    return of_these.model_to_compare(model, lag), fits.along("lag", lag[own], effect)


def describe_lag(clock: Clock, lag: Float64, std: Float64) -> Lag | str:
    """Decide whether a lag (2,), as of `Clock`, is to be corrected; a text that says why where it is not determined."""
    unit, interval = clock.series.unit, clock.series.interval
    if std[_LAG] > _LARGEST_STD * interval:
        return f"standard deviation {std[_LAG] / interval:.1f} frames; {MOVE}"
    drifts = lag[_DRIFT] != 0
    significant = abs(lag[_LAG]) > max(_SIGNIFICANT * std[_LAG], _LEAST_LAG * interval) or drifts
    described = Lag.of(float(lag[_LAG]), float(std[_LAG]), unit, interval, applied=bool(significant))
    if not drifts:
        return described
    middle = clock.middle + clock.series.origin
    return replace(described, drift=float(lag[_DRIFT]), std_drift=float(std[_DRIFT]), middle=middle)


@dataclass(frozen=True, eq=False)
class LagEstimate:
    """Estimate of the lag of a session's N frames.

    ``clock`` has the readings of the frames at any lag, None where they have no order. ``lag`` is None where it is not
    determined, and ``undetermined`` then says why; ``curve`` is the disagreement of the frames as a function of the
    lag. ``nowhere`` tells that they agree at none. ``shared`` tells that other arms' frames tell the lag, too.
    ``fixed`` tells that the lag was given, or is not looked for: neither is it searched nor refined.
    """

    clock: Clock | None
    lag: Lag | None = None
    undetermined: str = ""
    nowhere: bool = False
    curve: LagCurve | None = None
    shared: bool = False
    fixed: bool = False

    @classmethod
    def of(
        cls,
        series: ReadingSeries | None,
        names: Sequence[str],
        outer_std: Float64,
        given: Lag | Literal["auto"] | None = None,
    ) -> LagEstimate:
        """Return what is known before anything is estimated.

        Parameters
        ----------
        series
            The readings as functions of time, with the frames' times; None if there are none.
        names
            Those of the frames in the order of their model.
        outer_std
            (4,), of the readings of the outer joints.
        given
            The lag that is taken out, and neither searched nor refined; ``auto`` to look for it in readings without
            times that jump from row to row, too, which are those of postures and no recording.

        Raises
        ------
        InputError
            The given lag is not known in the unit of the series, or there are no readings to take it out of.
        """
        if series is not None and all(name in series.frames for name in names):
            clock = Clock.of(series, names, outer_std)
            if isinstance(given, Lag):
                value = given.in_unit(series.unit)
                lag = Lag.of(value, 0.0, series.unit, series.interval, applied=value != 0)
                return cls(clock, lag, fixed=True)
            if clock.postures and given is None:
                return cls(clock, undetermined=POSTURES, fixed=True)
            return cls(clock)
        if isinstance(given, Lag):
            if given.frames or given.seconds:
                raise InputError(
                    "lag: expected readings of numbered frames, or times of images and readings, got neither"
                )
            return cls(None, Lag.of(0.0, 0.0, "frames", 1.0, applied=False), fixed=True)
        return cls(
            None,
            undetermined="the frames have no order: name them by numbers, or give the times of images (images.csv) and "
            "readings",
        )

    @property
    def can_be_tried(self) -> bool:
        """Whether no lag is told, and the readings follow each other closely enough that one can be taken out."""
        return self.lag is None and not self.fixed and self.clock is not None and self.clock.interpolable

    @property
    def rivals(self) -> list[float]:
        """The lags at which frames agree about as well as at the one that the search has found, in the clock's unit."""
        return [] if self.curve is None or self.lag is None or self.fixed else self.curve.rivals

    def with_rivals(self) -> LagEstimate:
        """Return the estimate without the lag that the search has found, which is one of several alike."""
        assert self.curve is not None
        unit = self.curve.unit
        lags = ", ".join(f"{lag:.3g}" for lag in sorted((self.curve.best, *self.rivals)))
        text = f"frames agree about as well at {lags} {unit}, and at none they predict left-out frames clearly better"
        return replace(self, lag=None, undetermined=text)

    def with_trial(self, value: float) -> LagEstimate:
        """Return the estimate with a lag to be tried, in the unit of the readings' times; `refined` finds its std."""
        if self.clock is None:
            return replace(self, lag=None)
        series = self.clock.series
        step = self.clock.step or series.interval
        return replace(self, lag=Lag.of(value, step, series.unit, series.interval, applied=True))

    @property
    def applied(self) -> Lag | None:
        """The lag that is taken out of the readings; None if none is."""
        return self.lag if self.lag is not None and self.lag.applied else None

    def searched(self, model: SessionModel, modes: Sequence[Sequence[Mode]]) -> LagEstimate:
        """Find the lag from the frames' own modes; arguments as in `find_consensus`."""
        if self.clock is None or self.fixed:
            return self
        found = search_lag(self.clock, model, modes)
        told = replace(self, curve=found.curve, undetermined=found.undetermined, nowhere=found.nowhere)
        if found.lag is None or found.calibration is None:
            return told
        start = np.array([found.lag, 0.0])
        has = np.flatnonzero(self.clock.has_readings(start))
        shifted = self.clock.model_at(model, start).subset(has)
        chosen = choose_modes(shifted, [modes[int(i)] for i in has], found.calibration)
        fits = FrameFits.of_modes(chosen)
        return told._by(FramesOfLag(self.clock.subset(has), shifted, fits, found.calibration), start)

    def refined(self, model: SessionModel, fits: FrameFits, calibration: Calibration) -> LagEstimate:
        """Refine a lag that is taken out with the frames' fits; arguments as in `solve`.

        A lag at which a frame would have no readings is not taken.
        """
        if self.applied is None or self.clock is None or self.shared or self.fixed:
            return self
        found = self._by(FramesOfLag(self.clock, model, fits, calibration), self._value(self.clock))
        return found if found.all_have_readings else replace(found, lag=self.lag)

    @property
    def all_have_readings(self) -> bool:
        """Whether each frame has readings of all outer joints at the lag that is taken out."""
        clock, lag = self.clock, self.applied
        return clock is None or lag is None or bool(clock.has_readings(clock.values_of(lag)).all())

    def told_by_few(self, few: LagEstimate) -> LagEstimate:
        """Return the estimate with the lag that some of the frames told, unless a frame would have no readings there.

        Parameters
        ----------
        few
            The estimate of these frames.
        """
        told = replace(self, lag=few.lag, undetermined=few.undetermined)
        return told if told.all_have_readings else self

    def told_by_fits(
        self, model: SessionModel, fits: FrameFits, calibration: Calibration
    ) -> tuple[LagEstimate, float | None]:
        """Determine a lag that the modes did not tell from the frames' fits without one; arguments as in `solve`.

        Also returns the lag, in the unit of the readings' times, if it differs from zero: it is to be tried. If it does
        not, it is kept with its standard deviation, but for where the modes tell against it: each fit is near what the
        session without a lag expects, so that fits hardly tell others.
        """
        clock = self.clock
        if self.lag is not None or clock is None or self.fixed:
            return self, None
        found = refine_lag(FramesOfLag(clock, model, fits, calibration), np.zeros(2))
        lag = None if found is None else describe_lag(clock, *found)
        if found is None or not isinstance(lag, Lag):
            return self, None
        if lag.applied:
            return self, float(found[0][_LAG])
        against = self.curve is not None and self.curve.against_none
        return (self if against else replace(self, lag=lag)), None

    def with_others(self, others: Sequence[LagEstimate]) -> LagEstimate:
        """Return the estimate with the mean of the lags that the frames of several arms tell, by their deviations.

        A lag that disagrees, that drifts, or at which a frame would have no readings, is not shared: arms may have
        clocks of their own.
        """
        clock = self.clock
        if clock is None or not clock.interpolable or self.fixed or (self.lag is not None and self._told is None):
            return self
        same = [one for one in others if one.clock is not None and one.clock.series.unit == clock.series.unit]
        told = [each for one in (self, *same) if (each := one._told) is not None]
        if len(told) < (1 if self.lag is None else 2):
            return self
        values, stds = np.array(told).T
        weights = stds**-2.0
        mean, std = weights @ values / weights.sum(), weights.sum() ** -0.5
        if (np.abs(values - mean) > _AGREE * stds).any():
            return self
        lag = describe_lag(clock, np.array([mean, 0.0]), np.array([std, 0.0]))
        shared = replace(self, lag=lag, undetermined="", shared=True) if isinstance(lag, Lag) else self
        return shared if shared.all_have_readings else self

    @property
    def _told(self) -> tuple[float, float] | None:
        """The lag and its standard deviation in the unit of the clock; None where it is not determined, or drifts."""
        if self.lag is None or self.clock is None or self.lag.drift:
            return None
        std = self.lag.std_seconds if self.clock.series.unit == "s" else self.lag.std_frames
        return None if std is None else (float(self.clock.values_of(self.lag)[_LAG]), std)

    def change_of_predictions(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes (N, D) of what is predicted of the frames, by one standard deviation of the lag.

        They are in the root's axes and of the joints, m and rad; zero where the readings cannot be interpolated, or a
        frame has none there. A lag that the frames do not determine has the standard deviation that the curve tells,
        but at least `_UNDETERMINED` frames.
        """
        none = np.zeros((len(model.outer), 6 + len(model.names)))
        if self.clock is None or not self.clock.interpolable:
            return none
        unit, interval = self.clock.series.unit, self.clock.series.interval
        told = None if self.lag is None else (self.lag.std_seconds if unit == "s" else self.lag.std_frames)
        lag = self._value(self.clock)
        step = self._undetermined_std(interval) if told is None else max(told, self._least_std(interval, lag[_LAG]))
        ends = [self.clock.model_at(model, lag + by * _WHOLE) for by in (step, -step)]
        later, earlier = (end.predict(calibration) for end in ends)
        change = later.minus(earlier) / 2
        return np.where(np.isnan(change).any(axis=1, keepdims=True), none, change)

    def _undetermined_std(self, interval: float) -> float:
        """Return the standard deviation of a lag that is not determined, where frames are an ``interval`` apart."""
        if self.curve is None or len(self.curve.lags) < 3:
            return _UNDETERMINED * interval
        told = self.curve.root_mean_square(len(self.clock.times) if self.clock else 0, _UNKNOWN * interval)
        return max(_UNDETERMINED * interval, told)

    def _least_std(self, interval: float, value: float) -> float:
        """Return the least standard deviation that the curve leaves a lag of some ``value``, as `_undetermined_std`."""
        if self.curve is None:
            return 0.0
        frames = len(self.clock.times) if self.clock else 0
        return self.curve.least_std(frames, _UNKNOWN * interval, value, applied=self.applied is not None)

    def has_readings(self) -> Bool:
        """Whether each frame has readings of all outer joints at the lag that is taken out, and near it, (N,).

        Near it is within half a step of the search, so that the lag can still be refined.
        """
        assert self.clock is not None
        assert self.applied is not None
        lag, reach = self._value(self.clock), (self.clock.step or 0.0) / 2
        if not self.clock.interpolable:
            return self.clock.has_readings(lag)
        near = [self.clock.has_readings(lag + by * _WHOLE) for by in (-reach, reach)]
        return np.asarray(near[0] & near[1])

    def corrected(self, model: SessionModel) -> SessionModel:
        """Return the model with the readings of the times of the images less the lag that is taken out."""
        if self.applied is None or self.clock is None:
            return model
        return self.clock.model_at(model, self._value(self.clock))

    def seconds(self) -> Float64 | None:
        """Return the times (N,), s, at which the arm was read as the images show it; None where they are not known."""
        clock = self._timed
        return None if clock is None else clock.seconds(self._value(clock))

    def play(self, names: Sequence[str], readings: Float64, width: Float64) -> Play | None:
        """Return how far joints stay behind their readings, as `Clock.play`; None where the times are not known."""
        clock = self._timed
        return None if clock is None else clock.play(names, readings, width, self._value(clock))

    @property
    def _timed(self) -> Clock | None:
        """The clock if it tells the time between frames.

        Frames that are only counted are taken for consecutive images, but not if their readings jump from row to row:
        then they were picked from a recording, and the time between them is not known.
        """
        clock = self.clock
        return clock if clock is not None and (clock.series.unit == "s" or clock.interpolable) else None

    def _value(self, clock: Clock) -> Float64:
        """Return the lag (2,) that is taken out, as of the clock."""
        return clock.values_of(self.applied)

    def subset(self, kept: Sequence[int]) -> LagEstimate:
        """Return the estimate of the frames at some indices."""
        return self if self.clock is None else replace(self, clock=self.clock.subset(kept))

    def _by(self, frames: FramesOfLag, start: Float64) -> LagEstimate:
        """Refine the lag and its drift from a start (2,), and keep them where they are determined.

        A drift is kept if it is significant and changes the lag noticeably in half of the session; a lag that is
        applied stays so. A lag of readings that cannot be interpolated is left as it is.
        """
        clock = frames.clock
        found, half, least = None, clock.half_duration, _LEAST_LAG * clock.series.interval
        if half * _DRIFT_STD >= least / 4:
            found = refine_lag(frames, start, (_LAG, _DRIFT))
        if found is not None and not abs(found[0][_DRIFT]) > max(_SIGNIFICANT * found[1][_DRIFT], least / half):
            start, found = np.array([found[0][_LAG], 0.0]), None
        if found is None:
            found = refine_lag(frames, start)
        if clock.step and not clock.interpolable:
            found = start, np.array([clock.step / np.sqrt(12), 0.0])
        lag: Lag | str = "the frames' disagreement has no minimum there, or too few frames have readings"
        if found is not None:
            lag = describe_lag(clock, *found)
        if isinstance(lag, Lag):
            return replace(self, lag=replace(lag, applied=lag.applied or self.applied is not None))
        return replace(self, undetermined=lag) if self.lag is None else self
