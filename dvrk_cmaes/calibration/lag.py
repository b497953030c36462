"""The lag of the images behind the readings, which all frames of a session share.

A wrong lag gives a moving arm readings of another moment, so that the frames' poses no longer agree on one
camera_from_base: `lag_search` finds where they agree best. Here is what is known of it, and the readings at any lag.

The lag is no block of the rounds in which frames are fitted again: frames whose prior is the prediction at a lag agree
with this lag, and estimates by their fits were farther from true ones than those by modes, by up to half a frame. Its
error counts in all that is stated (`SessionLag.change_of_predictions`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration
from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.model import SessionModel, frames_alike
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool, Float64, Indices
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number
from dvrk_cmaes.joints.cable_prior import Play, play_between
from dvrk_cmaes.joints.lag import Lag, Unit
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.joints.series import ReadingSeries

FRAME_SECONDS: Final = 1 / 30
"""Time between images that have no times."""
LEAST_AT_LAG: Final = 4
"""Frames that must have readings at a lag."""
MOVE: Final = "a recording in which the arm moves quickly would determine it"
NO_READINGS_AT_LAG: Final = "no readings once the lag is taken out"
"""Why a frame is left out."""
NOT_INTERPOLABLE: Final = (
    "the readings jump from row to row, as those of postures or of frames picked from a recording: give all rows of "
    "the recording, with times"
)
"""Why no lag is looked for."""
NO_ORDER: Final = (
    "the frames have no order: name them by numbers, or give the times of images (images.csv) and readings"
)
"""Why none can be."""

# readings
_ROUGH = 5.0  # standard deviations of a reading that it may change unevenly from row to row
# what a curve shows
_FREEDOM = 5.0  # degrees of freedom of a pose that errs independently of the others
_FLAT = 1.0  # steps of the curve: root mean square of what it allows, from which on it hardly determines a lag
_OF_A_LAG, _OF_NONE = 0.5, 0.7  # of that, least standard deviation of a lag, and of none
_UNDETERMINED, _UNKNOWN = 2.0, 3.0  # frames, least and largest standard deviation of a lag that is not determined
_LEAST_ALIKE = 4.0  # frames that count as one, however far apart they are: they share errors of masks and readings
# decision
_SIGNIFICANT, _SHOWN = 1.5, 2.0  # standard deviations, of a lag and of the frames' agreement
_LEAST_LAG = 0.3  # frames, below which a lag is not corrected
_LARGEST_STD = 1.5  # frames, above which the lag is not determined
_AGREE = 3.0  # standard deviations of each lag, within which those of several arms are taken for one


@dataclass(frozen=True)
class LagCurve(Document):
    """Disagreement of the frames as a function of the lag.

    Each of the ``points`` is a lag in a ``unit``, s or frames, and a misfit: the mean of the frames' squared
    Mahalanobis distances from their consensus by degree of freedom, each at most `INLIER_MISFIT`. It shows as much as
    that of ``frames`` that err independently of each other.
    """

    unit: Unit
    points: tuple[tuple[Number, Number], ...]
    frames: Number = 1.0

    @property
    def lags(self) -> Float64:
        """The lags (L,)."""
        return np.array([lag for lag, _ in self.points])

    @property
    def misfit(self) -> Float64:
        """The misfits (L,)."""
        return np.array([misfit for _, misfit in self.points])

    def root_mean_square(self, unknown: float, about: float = 0.0) -> float:
        """Return the root mean square of how far the lags that the curve allows are from one, in its unit.

        Parameters
        ----------
        unknown
            Prior standard deviation of the lag, in the unit of the curve. The result is at most the root mean square
            of what the prior allows.
        about
            The lag from which the others are counted.
        """
        squares = _FREEDOM * self.frames * (self.misfit - self.misfit.min())
        weights = np.exp(-0.5 * (squares + (self.lags / unknown) ** 2))
        return float(min(np.sqrt(weights @ (self.lags - about) ** 2 / weights.sum()), np.hypot(unknown, about)))

    def shows(self, value: float, frames: int) -> bool:
        """Whether some ``frames`` agree better at a lag than at none, by `_SHOWN` standard deviations of their scatter.

        Lags within one step of none are not distinguished by the curve, and count as shown.
        """
        about = np.abs(self.lags - value) < np.diff(self.lags).max(initial=0.0)
        if about[np.abs(self.lags).argmin()]:
            return True
        gain = np.interp(0.0, self.lags, self.misfit) - self.misfit[about].min(initial=np.inf)
        return bool(_FREEDOM * frames / _LEAST_ALIKE * gain > _SHOWN**2 * self.misfit.min())


def lag_taken_out(lag: Lag | None, curve: LagCurve | None, unit: Unit, unknown: float) -> tuple[float, float] | None:
    """Return the lag that is taken out of readings, and its standard deviation; None if nothing shows one.

    Where it is not determined, none is taken out, and the curve of disagreement says how large it may be. Where the
    curve is flat, as with few frames, the standard deviation is larger than that of the least disagreement: errors that
    frames share displace that, or make a lag where there is none.

    Parameters
    ----------
    lag, curve
        What is found of the lag, and the disagreement of the frames.
    unit
        Unit of the result.
    unknown
        Prior standard deviation of the lag.
    """
    curve = curve if curve is not None and curve.unit == unit and len(curve.lags) > 1 else None
    found, std = (None, None) if lag is None else lag.known_in(unit)
    if lag is None or found is None:
        return None if curve is None else (0.0, curve.root_mean_square(unknown))
    value = found if lag.applied else 0.0
    if curve is not None:
        allowed = curve.root_mean_square(unknown, value)
        flat = allowed > _FLAT * float(np.diff(curve.lags).max())
        std = max(std or 0.0, allowed * (_OF_A_LAG if lag.applied else _OF_NONE) if flat else 0.0)
    return value, std or 0.0


@dataclass(frozen=True, eq=False)
class SessionLag:
    """The readings of an arm's N frames at any lag of the images, and what is known of the lag.

    ``series`` are all readings, None where the frames have no order; ``times`` (N,) those of the frames' images on its
    clock. ``interpolable`` says whether the readings may be interpolated, because the rows follow each other closely in
    time, as none of postures do; a lag is looked for in such readings only. Frames within ``alike_seconds`` err
    alike, and count as one.

    ``lag`` is None where it is not determined, and ``undetermined`` then says why; ``curve`` is the disagreement of the
    frames as a function of the lag, ``nowhere`` says that they agree at none. ``fixed`` says that the lag was given.
    """

    series: ReadingSeries | None
    times: Float64
    interpolable: bool = False
    alike_seconds: float = 0.0
    lag: Lag | None = None
    undetermined: str = ""
    nowhere: bool = False
    curve: LagCurve | None = None
    fixed: bool = False

    @classmethod
    def of(
        cls,
        series: ReadingSeries | None,
        names: Sequence[str],
        outer_std: Float64,
        given: Lag | None = None,
        alike_seconds: float = 0.0,
    ) -> SessionLag:
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
            The lag that is taken out, and neither searched nor refined.
        alike_seconds
            Time in which frames err alike, s.

        Raises
        ------
        InputError
            The given lag is not known in the unit of the series, or there are no readings to take it out of.
        """
        if series is None or not all(name in series.frames for name in names):
            without_order = cls(None, np.full(len(names), np.nan), undetermined=NO_ORDER)
            if given is None:
                return without_order
            if given.frames or given.seconds:
                raise InputError(
                    "lag: expected readings of numbered frames, or times of images and readings, got neither"
                )
            return replace(without_order, lag=Lag.of(0.0, 0.0, "frames", 1.0, applied=False), fixed=True)
        postures = series.unit == "frames" and series.jumps(OUTER_JOINTS, _ROUGH * outer_std)
        interpolable = not postures and series.is_interpolable(OUTER_JOINTS, _ROUGH * outer_std)
        found = cls(series, np.array([series.frames[name] for name in names]), interpolable, alike_seconds)
        if given is not None:
            value = given.in_unit(series.unit)
            lag = Lag.of(value, 0.0, series.unit, series.interval, applied=value != 0)
            return replace(found, lag=lag, fixed=True)
        return found if interpolable else replace(found, undetermined=NOT_INTERPOLABLE)

    def subset(self, index: Sequence[int] | Indices) -> SessionLag:
        """Return that of the frames at some indices."""
        return replace(self, times=self.times[np.asarray(index, dtype=np.intp)])

    # readings at a lag

    @property
    def readings(self) -> ReadingSeries:
        """The series of readings that are known to have an order."""
        assert self.series is not None
        return self.series

    @property
    def applied(self) -> Lag | None:
        """The lag that is taken out of the readings; None if none is."""
        return self.lag if self.lag is not None and self.lag.applied else None

    @property
    def value(self) -> float:
        """The lag that is taken out, in the unit of the series; zero if none is."""
        return 0.0 if self.applied is None or self.series is None else self.applied.in_unit(self.series.unit)

    def read_times(self, value: float) -> Float64:
        """Return the times (N,) at which the arm was read as the images show it."""
        return np.asarray(self.times - value)

    def has_readings(self, value: float) -> Bool:
        """Whether each frame has readings of all outer joints at a lag, (N,)."""
        return np.asarray(~np.isnan(self.readings.at(OUTER_JOINTS, self.read_times(value))).any(axis=1))

    def model_at(self, model: SessionModel, value: float, *, smoothed: bool = False) -> SessionModel:
        """Return a model with the readings of the times of the images less a lag, by a spline if ``smoothed``."""
        read, endoscope = self.read_times(value), model.endoscope
        outer, joints = (self.readings.at(names, read, smoothed=smoothed) for names in (OUTER_JOINTS, model.names))
        if isinstance(endoscope, Steered):
            endoscope = endoscope.at(self.readings.at(ECM_JOINTS, read))
        return replace(model, outer=outer, joints=joints, endoscope=endoscope)

    # times of the frames

    @property
    def independent(self) -> float:
        """Number of frames that would show as much as these do, if each erred independently of the others."""
        alike = frames_alike(self.unit_seconds * self.times, self.alike_seconds)
        return float(min((1 / alike).sum(), len(alike) / _LEAST_ALIKE))

    @property
    def unit_seconds(self) -> float:
        """Length of the unit of the series, s; images that are only counted are 1 / 30 s apart."""
        return 1.0 if self.readings.unit == "s" else FRAME_SECONDS

    @property
    def _timed(self) -> bool:
        """Whether the time between frames is known.

        Frames that are only counted are taken for consecutive images, but not if their readings jump from row to row:
        then they were picked from a recording, and the time between them is not known.
        """
        return self.series is not None and (self.series.unit == "s" or self.interpolable)

    def seconds(self) -> Float64:
        """Return the times (N,), s, at which the arm was read as the images show it; NaN where they are not known."""
        return self.unit_seconds * self.read_times(self.value) if self._timed else np.full(len(self.times), np.nan)

    def play(self, names: Sequence[str], readings: Float64, width: Float64) -> Play | None:
        """Return how far C joints stay behind their readings (N, C); None where the times are not known.

        ``width`` (C,), rad, is that of their play; all readings of the series count.
        """
        if not self._timed:
            return None
        at, of_joints, series = self.read_times(self.value), [], self.readings
        for name, column, band in zip(names, readings.T, width, strict=True):
            times, values = series.times.get(name), series.values.get(name)
            if times is None or values is None:
                times, values = np.zeros(1), np.full(1, np.nan)
            of_joints.append(play_between(times, values, float(band), at, column))
        return Play(*(np.stack(part, axis=1) for part in zip(*of_joints, strict=True)))

    # what is known of the lag

    def with_estimate(self, found: tuple[float, float] | None, *, shown: bool) -> SessionLag:
        """Return a lag that was estimated, to be taken out if it is significant, or why it is not determined.

        ``shown`` is whether the curve shows it, too: wrong poses of some frames move an estimate beyond its error.
        """
        if found is None:
            text = "the frames' disagreement has no minimum there, or too few frames have readings"
            return replace(self, lag=None, undetermined=text)
        (value, std), series = found, self.readings
        if std > _LARGEST_STD * series.interval:
            text = f"standard deviation {std / series.interval:.1f} frames; {MOVE}"
            return replace(self, lag=None, undetermined=text)
        significant = shown and abs(value) > max(_SIGNIFICANT * std, _LEAST_LAG * series.interval)
        lag = Lag.of(value, std, series.unit, series.interval, applied=significant)
        return replace(self, lag=lag, undetermined="")

    @property
    def known(self) -> tuple[float, float] | None:
        """The lag and its standard deviation in the unit of the series; None where it is not determined."""
        value, std = (None, None) if self.lag is None or self.series is None else self.lag.known_in(self.series.unit)
        return None if value is None or std is None else (value, std)

    def change_of_predictions(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes (N, D) of what is predicted of the frames, by one standard deviation of the lag.

        They are in the root's axes and of the joints, m and rad; zero where the readings cannot be interpolated, or a
        frame has none there. A lag that the frames do not determine has the standard deviation that the curve shows,
        but at least `_UNDETERMINED` frames.
        """
        none = np.zeros((len(model.outer), 6 + len(model.names)))
        if not self.interpolable:
            return none
        series = self.readings
        _, step = lag_taken_out(self.lag, self.curve, series.unit, _UNKNOWN * series.interval) or (0.0, 0.0)
        if self.lag is None:
            step = max(_UNDETERMINED * series.interval, step)
        later, earlier = (self.model_at(model, self.value + by).predict(calibration) for by in (step, -step))
        change = later.minus(earlier) / 2
        return np.where(np.isnan(change).any(axis=1, keepdims=True), none, change)


def in_common(lags: Sequence[SessionLag]) -> list[SessionLag]:
    """Return the lags of a session's arms, of which those that agree become their mean by the standard deviations.

    An arm whose frames do not show its lag has that of the others. A lag that disagrees, or at which few
    frames would have readings, is that of its arm alone: arms may have clocks of their own.
    """
    found = np.array([known for lag in lags if (known := lag.known) is not None])
    units = {lag.series.unit for lag in lags if lag.series is not None}
    if len(lags) < 2 or not len(found) or len(units) > 1 or not all(lag.interpolable and not lag.fixed for lag in lags):
        return list(lags)
    values, stds = found.T
    weights = stds**-2.0
    mean = float(weights @ values / weights.sum())
    shown = any(lag.curve is not None and lag.curve.shows(mean, len(lag.times)) for lag in lags)
    shared = [lag.with_estimate((mean, float(weights.sum() ** -0.5)), shown=shown) for lag in lags]
    agree = (np.abs(values - mean) <= _AGREE * stds).all()
    usable = all(lag.lag is not None and lag.has_readings(lag.value).sum() >= LEAST_AT_LAG for lag in shared)
    return shared if agree and usable else list(lags)
