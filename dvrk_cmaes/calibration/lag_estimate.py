"""The lag of a session while it is calibrated: found from the frames' own modes, then refined with their fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.calibration.clock import Clock, Delay
from dvrk_cmaes.calibration.consensus import Mode, choose_modes
from dvrk_cmaes.calibration.lag import LagCurve, LagRefiner, Refined, describe_lag, search_lag
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.calibration.solve import FrameFits
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.play import Play
from dvrk_cmaes.joints.series import ReadingSeries

_UNDETERMINED = 2.0  # frames, least standard deviation of a lag that is not determined, and ...
_UNKNOWN = 3.0  # ... largest
_AGREE = 3.0  # standard deviations of each lag, within which those of several arms are taken for one


@dataclass(frozen=True, eq=False)
class LagEstimate:
    """Estimate of the lag of a session's N frames.

    ``clock`` has the readings of the frames at any lag, None where they have no order. ``lag`` is None where it is not
    determined, and ``undetermined`` then says why; ``curve`` is the disagreement of the frames as a function of the
    lag. ``nowhere`` tells that they agree at none. ``shared`` tells that other arms' frames tell the lag, too.
    """

    clock: Clock | None
    lag: Lag | None = None
    undetermined: str = ""
    nowhere: bool = False
    curve: LagCurve | None = None
    shared: bool = False

    @classmethod
    def of(cls, series: ReadingSeries | None, names: Sequence[str], outer_std: Float64) -> LagEstimate:
        """Return what is known before anything is estimated.

        ``series`` are the readings as functions of time, with the frames' times; None if there are none. ``names`` are
        those of the frames in the order of their model, ``outer_std`` (4,) are of the readings of the outer joints.
        """
        if series is not None and all(name in series.frames for name in names):
            return cls(Clock.of(series, names, outer_std))
        return cls(
            None,
            undetermined="the frames have no order: name them by numbers, or give the times of images (images.csv) and "
            "readings",
        )

    @property
    def can_be_tried(self) -> bool:
        """Whether no lag is told, and the readings follow each other closely enough that one can be taken out."""
        return self.lag is None and self.clock is not None and self.clock.interpolable

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

    def searched(
        self, model: SessionModel, modes: Sequence[Sequence[Mode]], offset_std: Float64, prior: Float64
    ) -> LagEstimate:
        """Find the lag from the frames' own modes.

        Parameters
        ----------
        model, modes, offset_std
            As in `find_consensus`.
        prior
            As in `solve`.
        """
        if self.clock is None:
            return self
        found = search_lag(self.clock, model, modes, offset_std)
        told = replace(self, curve=found.curve, undetermined=found.undetermined, nowhere=found.nowhere)
        if found.lag is None or found.calibration is None:
            return told
        start = Delay(found.lag)
        has = np.flatnonzero(self.clock.has_readings(start))
        shifted = self.clock.model_at(model, start).subset(has)
        chosen = choose_modes(shifted, [modes[int(i)] for i in has], found.calibration)
        clock = self.clock.subset(has)
        return told._by(LagRefiner(clock, shifted, FrameFits.of_modes(chosen), found.calibration, prior, start))

    def refined(self, model: SessionModel, fits: FrameFits, calibration: Calibration, prior: Float64) -> LagEstimate:
        """Refine a lag that is taken out with the frames' fits; arguments as in `solve`.

        A lag at which a frame would have no readings is not taken.
        """
        if self.applied is None or self.clock is None or self.shared:
            return self
        start = self.clock.delay_of(self.applied)
        found = self._by(LagRefiner(self.clock, model, fits, calibration, prior, start))
        return found if found.all_have_readings else replace(found, lag=self.lag)

    @property
    def all_have_readings(self) -> bool:
        """Whether each frame has readings of all outer joints at the lag that is taken out."""
        clock, lag = self.clock, self.applied
        return clock is None or lag is None or bool(clock.has_readings(clock.delay_of(lag)).all())

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
        self, model: SessionModel, fits: FrameFits, calibration: Calibration, prior: Float64
    ) -> tuple[LagEstimate, float | None]:
        """Determine a lag that the modes did not tell from the frames' fits without one; arguments as in `solve`.

        Also returns the lag, in the unit of the readings' times, if it differs from zero: it is to be tried. If it does
        not, it is kept with its standard deviation, but for where the modes tell against it: each fit is near what the
        session without a lag expects, so that fits hardly tell others.
        """
        clock = self.clock
        if self.lag is not None or clock is None:
            return self, None
        value = LagRefiner(clock, model, fits, calibration, prior, Delay()).refine_value()
        lag = None if value is None or not clock.interpolable else describe_lag(clock, value)
        if value is None or not isinstance(lag, Lag):
            return self, None
        if lag.applied:
            return self, value.value
        against = self.curve is not None and self.curve.against_none
        return (self if against else replace(self, lag=lag)), None

    def with_others(self, others: Sequence[LagEstimate]) -> LagEstimate:
        """Return the estimate with the mean of the lags that the frames of several arms tell, by their deviations.

        A lag that disagrees, that drifts, or at which a frame would have no readings, is not shared: arms may have
        clocks of their own.
        """
        clock = self.clock
        if clock is None or not clock.interpolable or (self.lag is not None and self._told is None):
            return self
        same = [one for one in others if one.clock is not None and one.clock.series.unit == clock.series.unit]
        told = [each for one in (self, *same) if (each := one._told) is not None]
        if len(told) < (1 if self.lag is None else 2):
            return self
        weights = np.array([one.std**-2.0 for one in told])
        value, std = float(weights @ [one.value for one in told] / weights.sum()), float(weights.sum() ** -0.5)
        if any(abs(one.value - value) > _AGREE * one.std for one in told):
            return self
        lag = describe_lag(clock, Refined(value, std))
        shared = replace(self, lag=lag, undetermined="", shared=True) if isinstance(lag, Lag) else self
        return shared if shared.all_have_readings else self

    @property
    def _told(self) -> Refined | None:
        """The lag in the unit of the readings' times; None where it is not determined, or drifts."""
        if self.lag is None or self.clock is None or self.lag.drift:
            return None
        std = self.lag.std_seconds if self.clock.series.unit == "s" else self.lag.std_frames
        return None if std is None else Refined(self.clock.delay_of(self.lag).value, std)

    def with_joints(
        self, model: SessionModel, fits: FrameFits, calibration: Calibration, prior: Float64
    ) -> LagEstimate:
        """Estimate the additional lag of the readings of wrist and jaw; arguments as in `solve`."""
        if self.lag is None or self.clock is None:
            return self
        wrist = LagRefiner(self.clock, model, fits, calibration, prior, self._delay(self.clock)).estimate_joints()
        if wrist is None:
            return self
        frame = self.clock.series.interval
        return replace(
            self, lag=replace(self.lag, wrist_frames=wrist.value / frame, std_wrist_frames=wrist.std / frame)
        )

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
        delay = self._delay(self.clock)
        step = self._undetermined_std(interval) if told is None else max(told, self._least_std(interval, delay.value))
        ends = [self.clock.model_at(model, replace(delay, value=delay.value + by)) for by in (step, -step)]
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
        delay, reach = self.clock.delay_of(self.applied), (self.clock.step or 0.0) / 2
        if not self.clock.interpolable:
            return self.clock.has_readings(delay)
        near = [self.clock.has_readings(replace(delay, value=delay.value + by)) for by in (-reach, reach)]
        return np.asarray(near[0] & near[1])

    def corrected(self, model: SessionModel) -> SessionModel:
        """Return the model with the readings of the times of the images less the lag that is taken out."""
        if self.applied is None or self.clock is None:
            return model
        return self.clock.model_at(model, self.clock.delay_of(self.applied))

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
        clock = self.clock
        return clock if clock is not None and (clock.series.unit == "s" or clock.interpolable) else None

    def _delay(self, clock: Clock) -> Delay:
        """Return the lag that is taken out, as a delay."""
        return Delay() if self.applied is None else clock.delay_of(self.applied)

    def subset(self, kept: Sequence[int]) -> LagEstimate:
        """Return the estimate of the frames at some indices."""
        return self if self.clock is None else replace(self, clock=self.clock.subset(kept))

    def _by(self, refiner: LagRefiner) -> LagEstimate:
        """Refine the lag and its drift, and keep them where they are determined; a lag that is applied stays so."""
        value, before = refiner.refine_value(), refiner.delay.drift
        drift = refiner.refine_drift()
        if refiner.delay.drift != before:
            value = refiner.refine_value()
        lag: Lag | str = "the frames' disagreement has no minimum there, or too few frames have readings"
        if value is not None:
            assert self.clock is not None
            lag = describe_lag(self.clock, value, drift)
        if isinstance(lag, Lag):
            return replace(self, lag=replace(lag, applied=lag.applied or self.applied is not None))
        return replace(self, undetermined=lag) if self.lag is None else self
