"""Readings of a session's frames at any lag of the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.model import Deviations, SessionModel
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.joints.play import Play, play_between
from dvrk_cmaes.joints.series import ReadingSeries

RANGE = {"frames": (-5.0, 15.0), "s": (-0.25, 0.75)}
"""Least and largest lag of the search, by unit."""

FARTHEST = {"frames": 90.0, "s": 3.0}
"""Largest lag of the search, in either direction, where the frames agree at no lag in `RANGE`."""

_FRAME_SECONDS = 1 / 30  # between images that have no times
_STEP = {"frames": 1.0, "s": _FRAME_SECONDS}  # of the search, at most the time between images
_MOST_STEPS = 61
_CABLE_SECONDS = 2.0  # for which the errors of the joints that cables move stay alike
_ROUGH = 5.0  # standard deviations of a reading that it may change unevenly from row to row


@dataclass(frozen=True, eq=False)
class Clock:
    """Readings of a session's frames at any lag.

    A ``lag`` (2,) is that in the middle of the frames, in the unit of the series, and its change by time.

    ``times`` (N,) are those of the frames' images on the clock of the ``series``, ``middle`` is the middle of the times
    of all frames. ``interpolable`` tells whether the readings may be interpolated, because the rows follow each other
    closely in time; ``postures`` that the rows have no times and jump, so that they are no recording. ``step`` is that
    of the search for the lag, in the unit of the series; for readings that cannot be interpolated it is the time
    between their rows, None if that is not constant.
    """

    series: ReadingSeries
    times: Float64
    middle: float
    interpolable: bool
    step: float | None
    postures: bool = False

    @classmethod
    def of(cls, series: ReadingSeries, names: Sequence[str], outer_std: Float64) -> Clock:
        """Create the clock of frames in the order of their model; ``outer_std`` (4,) are of the outer readings."""
        low, high = RANGE[series.unit]
        postures = series.unit == "frames" and series.jumps(OUTER_JOINTS, _ROUGH * outer_std)
        interpolable = not postures and series.is_interpolable(OUTER_JOINTS, _ROUGH * outer_std)
        fine = max(min(_STEP[series.unit], series.interval), (high - low) / (_MOST_STEPS - 1))
        step = fine if interpolable else series.spacing(OUTER_JOINTS[0])
        times = np.array([series.frames[name] for name in names])
        return cls(series, times, float(times.min() + times.max()) / 2, interpolable, step, postures)

    @property
    def _unit_seconds(self) -> float:
        """Length of the unit of the series, s; images that are only counted are 1 / 30 s apart."""
        return 1.0 if self.series.unit == "s" else _FRAME_SECONDS

    @property
    def half_duration(self) -> float:
        """Half of the time between the first and the last image."""
        return float(np.ptp(self.times)) / 2

    def subset(self, index: Sequence[int] | NDArray[np.integer]) -> Clock:
        """Return the clock of some of the frames."""
        return replace(self, times=self.times[np.asarray(index, dtype=np.intp)])

    def values_of(self, lag: Lag | None) -> Float64:
        """Return a lag (2,) in the unit of this clock; zero for None."""
        if lag is None:
            return np.zeros(2)
        middle = np.array([self.middle + self.series.origin])
        return np.array([lag.at(middle, self.series.unit)[0], lag.drift])

    def model_at(self, model: SessionModel, lag: Float64) -> SessionModel:
        """Return the model with the readings of the times of the images less the lag."""
        return self._model_at(model, lag, model.deviations, smoothed=False)

    def model_to_compare(self, model: SessionModel, lag: Float64) -> SessionModel:
        """Return the model of `model_at` by which lags are compared.

        Its readings are smoothed where they may be interpolated: otherwise a lag between two rows would agree better
        than one at a row, because it averages the noise of both. The errors of joints that cables move last for
        seconds, so that frames close to each other count as one for these joints: play in the cables would
        otherwise be taken for a lag.
        """
        count = len(self.times)
        spacing = 2 * self.half_duration / max(count - 1, 1) * self._unit_seconds
        factor = float(np.sqrt(np.clip(_CABLE_SECONDS / max(spacing, 1e-9), 1.0, count)))
        own = model.deviations
        outer = own.outer * np.where(np.array(OUTER_JOINTS) == "roll", factor, 1.0)
        return self._model_at(model, lag, replace(own, outer=outer, joints=factor * own.joints), smoothed=True)

    def _model_at(self, model: SessionModel, lag: Float64, deviations: Deviations, *, smoothed: bool) -> SessionModel:
        read, spline = self.read_times(lag), smoothed and self.interpolable
        outer = self.series.at(OUTER_JOINTS, read, smoothed=spline)
        joints = self.series.at(model.names, read, smoothed=spline)
        endoscope = model.endoscope
        if isinstance(endoscope, Steered):
            endoscope = endoscope.at(self.series.at(ECM_JOINTS, read))
        return replace(model, outer=outer, joints=joints, deviations=deviations, endoscope=endoscope)

    def seconds(self, lag: Float64) -> Float64:
        """Return the times (N,), s, at which the arm was read; images that are only counted are 1 / 30 s apart."""
        return self._unit_seconds * self.read_times(lag)

    def play(self, names: Sequence[str], readings: Float64, width: Float64, lag: Float64) -> Play:
        """Return how far C joints stay behind their readings (N, C) at the times of the frames less the lag.

        ``width`` (C,), rad, is that of their play; all readings of the series count.
        """
        at, of_joints = self.read_times(lag), []
        for name, column, band in zip(names, readings.T, width, strict=True):
            times, values = self.series.times.get(name), self.series.values.get(name)
            if times is None or values is None:
                times, values = np.zeros(1), np.full(1, np.nan)
            of_joints.append(play_between(times, values, float(band), at, column))
        return Play(*(np.stack(part, axis=1) for part in zip(*of_joints, strict=True)))

    def has_readings(self, lag: Float64) -> Bool:
        """Whether each frame has readings of all outer joints at a lag, (N,)."""
        return np.asarray(~np.isnan(self.series.at(OUTER_JOINTS, self.read_times(lag))).any(axis=1))

    def read_times(self, lag: Float64) -> Float64:
        """Return the times (N,) at which the arm was read as the images show it."""
        return np.asarray(self.times - lag[0] - lag[1] * (self.times - self.middle))
