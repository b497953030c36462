"""The lag of a session while it is calibrated: found from the frames' own modes, then refined with their fits."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.clock import Clock, Delay
from dvrk_cmaes.calibration.consensus import Mode, choose_modes
from dvrk_cmaes.calibration.lag import LagCurve, LagRefiner, describe_lag, search_lag
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.calibration.solve import FrameFits
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.play import Play
from dvrk_cmaes.joints.series import ReadingSeries

Float64 = NDArray[np.float64]

_UNTOLD = 2.0  # frames, least standard deviation of a lag that is not determined, and ...
_UNKNOWN = 3.0  # ... largest


class LagEstimate:
    """Estimate of the lag of a session's N frames.

    ``lag`` is None where it is not determined, and ``undetermined`` then says why; ``curve`` is the disagreement of the
    frames as a function of the lag. ``nowhere`` tells that they agree at none.

    Parameters
    ----------
    series
        Readings as functions of time, with the frames' times; None if there are none.
    names
        The names of the frames in the order of their model.
    outer_std : (4,)
        Standard deviations of the readings of the outer joints.
    """

    def __init__(self, series: ReadingSeries | None, names: Sequence[str], outer_std: Float64) -> None:
        self.lag: Lag | None = None
        self.undetermined = ""
        self.nowhere = False
        self.curve: LagCurve | None = None
        self._clock: Clock | None = None
        self._of_all: Clock | None = None
        if series is not None and all(name in series.frames for name in names):
            self._clock = self._of_all = Clock.of(series, names, outer_std)
        else:
            self.undetermined = (
                "the frames have no order: name them by numbers, or give the times of images (images.csv) and readings"
            )

    @property
    def can_be_tried(self) -> bool:
        """Whether no lag is told, and the readings follow each other closely enough that one can be taken out."""
        return self.lag is None and self._clock is not None and self._clock.interpolable

    def of_all(self) -> LagEstimate:
        """Return the estimate of all frames of the session, without a lag so far, but with the curve."""
        other = copy.copy(self)
        other.lag, other._clock = None, self._of_all
        return other

    def take(self, value: float) -> None:
        """Take a lag to be tried, in the unit of the readings' times; `refine` finds its standard deviation."""
        if self._clock is None:
            return
        series = self._clock.series
        self.lag = Lag.of(value, self._clock.step or series.interval, series.unit, series.interval, applied=True)

    @property
    def applied(self) -> Lag | None:
        """The lag that is taken out of the readings; None if none is."""
        return self.lag if self.lag is not None and self.lag.applied else None

    def search(self, model: SessionModel, modes: Sequence[Sequence[Mode]], offset_std: Float64, prior: Float64) -> None:
        """Find the lag from the frames' own modes.

        Parameters
        ----------
        model, modes, offset_std
            As in `find_consensus`.
        prior
            As in `solve`.
        """
        if self._clock is None:
            return
        searched = search_lag(self._clock, model, modes, offset_std)
        self.curve, self.undetermined, self.nowhere = searched.curve, searched.undetermined, searched.nowhere
        if searched.lag is None or searched.calibration is None:
            return
        start = Delay(searched.lag)
        has = np.flatnonzero(self._clock.has_readings(start))
        shifted = self._clock.model_at(model, start).subset(has)
        chosen = choose_modes(shifted, [modes[int(i)] for i in has], searched.calibration)
        clock = self._clock.subset(has)
        self._refine(LagRefiner(clock, shifted, FrameFits.of_modes(chosen), searched.calibration, prior, start))

    def refine(self, model: SessionModel, fits: FrameFits, calibration: Calibration, prior: Float64) -> None:
        """Refine a lag that is taken out with the frames' fits; arguments as in `solve`.

        A lag at which a frame would have no readings is not taken.
        """
        before = self.applied
        if before is None or self._clock is None:
            return
        self._refine(LagRefiner(self._clock, model, fits, calibration, prior, self._clock.delay_of(before)))
        if self.applied is not None and not self._clock.has_readings(self._clock.delay_of(self.applied)).all():
            self.lag = before

    def take_from(self, few: LagEstimate) -> None:
        """Take the lag that some of the frames told, unless another frame would have no readings there.

        Parameters
        ----------
        few
            The estimate of these frames.
        """
        applied = few.applied
        if applied is None or self._clock is None or self._clock.has_readings(self._clock.delay_of(applied)).all():
            self.lag, self.undetermined = few.lag, few.undetermined

    def tell_by_fits(
        self, model: SessionModel, fits: FrameFits, calibration: Calibration, prior: Float64
    ) -> float | None:
        """Determine a lag that the modes did not tell from the frames' fits without one; arguments as in `solve`.

        Returns the lag, in the unit of the readings' times, if it differs from zero: it is to be tried. If it does not,
        it is kept with its standard deviation, but for where the modes tell against it: each fit is near what the
        session without a lag expects, so that fits hardly tell others.
        """
        if self.lag is not None or self._clock is None:
            return None
        clock = self._clock
        value = LagRefiner(clock, model, fits, calibration, prior, Delay()).refine_value()
        lag = None if value is None or not clock.interpolable else describe_lag(clock, value)
        if value is None or not isinstance(lag, Lag):
            return None
        if lag.applied:
            return value.value
        if self.curve is None or not self.curve.against_none:
            self.lag = lag
        return None

    def estimate_joints(self, model: SessionModel, fits: FrameFits, calibration: Calibration, prior: Float64) -> None:
        """Estimate the additional lag of the readings of wrist and jaw; arguments as in `solve`."""
        if self.lag is None or self._clock is None:
            return
        wrist = LagRefiner(self._clock, model, fits, calibration, prior, self._delay(self._clock)).estimate_joints()
        if wrist is not None:
            frame = self._clock.series.interval
            self.lag = replace(self.lag, wrist_frames=wrist.value / frame, std_wrist_frames=wrist.std / frame)

    def change_of_predictions(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes (N, D) of what is predicted of the frames, by one standard deviation of the lag.

        They are in the root's axes and of the joints, m and rad; zero where the readings cannot be interpolated, or a
        frame has none there. A lag that the frames do not determine has the standard deviation that the curve tells,
        but at least `_UNTOLD` frames.
        """
        none = np.zeros((len(model.outer), 6 + len(model.names)))
        if self._clock is None or not self._clock.interpolable:
            return none
        unit, interval = self._clock.series.unit, self._clock.series.interval
        told = None if self.lag is None else (self.lag.std_seconds if unit == "s" else self.lag.std_frames)
        delay = self._delay(self._clock)
        step = self._untold_std(interval) if told is None else max(told, self._least_std(interval, delay.value))
        ends = [self._clock.model_at(model, replace(delay, value=delay.value + by)) for by in (step, -step)]
        later, earlier = (end.predict(calibration) for end in ends)
        change = later.minus(earlier) / 2
        return np.where(np.isnan(change).any(axis=1, keepdims=True), none, change)

    def _untold_std(self, interval: float) -> float:
        """Return the standard deviation of a lag that is not determined, where frames are an ``interval`` apart."""
        if self.curve is None or len(self.curve.lags) < 3:
            return _UNTOLD * interval
        told = self.curve.root_mean_square(len(self._clock.times) if self._clock else 0, _UNKNOWN * interval)
        return max(_UNTOLD * interval, told)

    def _least_std(self, interval: float, value: float) -> float:
        """Return the least standard deviation that the curve leaves a lag of some ``value``, as `_untold_std`."""
        if self.curve is None:
            return 0.0
        frames = len(self._clock.times) if self._clock else 0
        return self.curve.least_std(frames, _UNKNOWN * interval, value, applied=self.applied is not None)

    def has_readings(self) -> NDArray[np.bool_]:
        """Whether each frame has readings of all outer joints at the lag that is taken out, and near it, (N,).

        Near it is within half a step of the search, so that the lag can still be refined.
        """
        assert self._clock is not None
        assert self.applied is not None
        delay, reach = self._clock.delay_of(self.applied), (self._clock.step or 0.0) / 2
        if not self._clock.interpolable:
            return self._clock.has_readings(delay)
        near = [self._clock.has_readings(replace(delay, value=delay.value + by)) for by in (-reach, reach)]
        return np.asarray(near[0] & near[1])

    def corrected(self, model: SessionModel) -> SessionModel:
        """Return the model with the readings of the times of the images less the lag that is taken out."""
        if self.applied is None or self._clock is None:
            return model
        return self._clock.model_at(model, self._clock.delay_of(self.applied))

    def seconds(self) -> Float64 | None:
        """Return the times (N,), s, at which the arm was read as the images show it; None where they are not known."""
        clock = self._timed
        return None if clock is None else clock.seconds(self._delay(clock))

    def play(self, names: Sequence[str], readings: Float64, width: Float64) -> Play | None:
        """Return how far joints stay behind their readings, as `Clock.play`; None where the times are not known."""
        clock = self._timed
        return None if clock is None else clock.play(names, readings, width, self._delay(clock))

    @property
    def _timed(self) -> Clock | None:
        """The clock if it tells the time between frames.

        Frames that are only counted are taken for consecutive images, but not if their readings jump from row to row:
        then they were picked from a recording, and the time between them is not known.
        """
        clock = self._clock
        return clock if clock is not None and (clock.series.unit == "s" or clock.interpolable) else None

    def _delay(self, clock: Clock) -> Delay:
        """Return the lag that is taken out, as a delay."""
        return Delay() if self.applied is None else clock.delay_of(self.applied)

    def select(self, kept: Sequence[int]) -> None:
        """Keep only the frames at some indices."""
        if self._clock is not None:
            self._clock = self._clock.subset(kept)

    def _refine(self, refiner: LagRefiner) -> None:
        """Refine the lag and its drift, and store them where they are determined; a lag that is applied stays so."""
        value, before = refiner.refine_value(), refiner.delay.drift
        drift = refiner.refine_drift()
        if refiner.delay.drift != before:
            value = refiner.refine_value()
        lag: Lag | str = "the frames' disagreement has no minimum there, or too few frames have readings"
        if value is not None:
            assert self._clock is not None
            lag = describe_lag(self._clock, value, drift)
        if isinstance(lag, Lag):
            self.lag = replace(lag, applied=lag.applied or self.applied is not None)
        elif self.lag is None:
            self.undetermined = lag
