"""The lag of the images behind the readings, which all frames of a session share.

A wrong lag gives a moving arm readings of another moment, so that the frames' poses no longer agree on one
camera_from_base. A search by the frames' own modes finds where they agree best. From then on the lag is a block with
base and offsets: a change of it changes what is predicted of a frame by the velocity of its readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration, PredictedBlock
from dvrk_cmaes.calibration.consensus import Consensus, Mode, find_consensus
from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.solve import Solved
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool, Float64, Indices
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number
from dvrk_cmaes.joints.cables import Play, play_between
from dvrk_cmaes.joints.lag import Lag, Unit
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.joints.series import ReadingSeries

LAG: Final = "lag"
"""Name of the block."""
RANGE: Final = {"frames": (-5.0, 15.0), "s": (-0.25, 0.75)}
"""Least and largest lag of the search, by unit."""
FARTHEST: Final = {"frames": 90.0, "s": 3.0}
"""Largest lag of the search, in either direction, where the frames agree at no lag in `RANGE`."""
UNLIKELY: Final = 1.5
"""Ratio to the least misfit, from which on a lag is unlikely."""
MOVE: Final = "a recording in which the arm moves quickly would determine it"
NO_READINGS_AT_LAG: Final = "no readings once the lag is taken out"
"""Why a frame is left out."""
NOT_INTERPOLABLE: Final = (
    "the readings jump from row to row, as those of postures or of frames picked from a recording: give all rows of "
    "the recording, with times"
)
"""Why no lag is looked for."""

# readings
_FRAME_SECONDS = 1 / 30  # between images that have no times
_STEP = {"frames": 1.0, "s": _FRAME_SECONDS}  # of the search, at most the time between images
_MOST_STEPS = 61
_CABLE_SECONDS = 2.0  # for which the errors of the joints that cables move stay alike
_ROUGH = 5.0  # standard deviations of a reading that it may change unevenly from row to row
# search
_LEAST_FRAMES = 6  # of a session; with fewer, a lag cannot be distinguished from outliers
_LEAST_AT_LAG, _LEAST_SHARE = 4, 0.5  # frames, and share of them, that must have readings at a lag
_HYPOTHESIS_FRAMES, _TEST_FRAMES = 12, 60  # of each consensus of the search
_DISAGREE = 2.0  # mean misfit, of at most 4, from which on the frames agree hardly, and a lag is looked for far away
_NOWHERE = 3.0  # mean misfit from which on most frames disagree, and the best lag is one by chance
_COARSE = 3  # steps of the search, in each of the far one: the misfit falls over many times as much
# what a curve shows
_FREEDOM_OF_A_FRAME = 1.25  # degrees of freedom, of 5 of its pose: frames of a recording share errors
_UNDETERMINED, _UNKNOWN = 2.0, 3.0  # frames, least and largest standard deviation of a lag that is not determined
# the block
_SHARED_ERRORS = 2.0  # factor on the standard deviation: the frames of a recording share errors of masks and readings
_LEAST_STEP = 0.25  # of the differences, relative to the search's
_LEAST_PRIOR = 0.5  # frames, standard deviation of what is left of a lag
_ROLL_AXIS: Final = 5  # of a small change of the root's pose, which those of the joints follow
# decision
_SIGNIFICANT = 2.0  # standard deviations
_LEAST_LAG = 0.3  # frames, below which a lag is not corrected
_LARGEST_STD = 1.0  # frames, above which the lag is not determined
_AGREE = 3.0  # standard deviations of each lag, within which those of several arms are taken for one


class LagBlock(PredictedBlock):
    """What is still to be added to a lag (1,), in the unit of the frames' times.

    ``shared`` says whether the arms of the session have it in common.
    """

    nuisance = True

    def __init__(self, std: float, *, shared: bool) -> None:
        super().__init__(LAG, np.array([std]), (LAG,))
        self.shared = shared

    def change(self, model: SessionModel, value: Any) -> Float64 | None:
        """Return the changes of the predictions by a lag."""
        return None if model.by_lag is None else model.by_lag * value

    def derivative(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes of the predictions by those of the readings."""
        assert model.by_lag is not None
        return model.by_lag[:, :, None]


@dataclass(frozen=True)
class LagCurve(Document):
    """Disagreement of the frames as a function of the lag.

    Each of the ``points`` is a lag in a ``unit``, s or frames, and a misfit: the mean of the frames' squared
    Mahalanobis distances from their consensus by degree of freedom, each at most `INLIER_MISFIT`.
    """

    unit: Unit
    points: tuple[tuple[Number, Number], ...]

    @property
    def lags(self) -> Float64:
        """The lags (L,)."""
        return np.array([lag for lag, _ in self.points])

    @property
    def misfit(self) -> Float64:
        """The misfits (L,)."""
        return np.array([misfit for _, misfit in self.points])

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
        squares = _FREEDOM_OF_A_FRAME * frames * (self.misfit - self.misfit.min())
        weights = np.exp(-0.5 * (squares + (self.lags / unknown) ** 2))
        return float(min(np.sqrt(weights @ (self.lags - about) ** 2 / weights.sum()), np.hypot(unknown, about)))


class Refined(NamedTuple):
    """A lag in the unit of the readings' times, and its standard deviation."""

    value: float
    std: float


@dataclass(frozen=True, eq=False)
class SessionLag:
    """The readings of an arm's N frames at any lag of the images, and what is known of the lag.

    ``series`` are all readings, None where the frames have no order; ``times`` (N,) those of the frames' images on its
    clock. ``interpolable`` says whether the readings may be interpolated, because the rows follow each other closely in
    time, as none of postures do; a lag is looked for in such readings only. ``step`` is that of the search, in the unit
    of the series.

    ``lag`` is None where it is not determined, and ``undetermined`` then says why; ``curve`` is the disagreement of the
    frames as a function of the lag, ``nowhere`` says that they agree at none. ``fixed`` says that the lag was given:
    it is neither searched nor refined. ``alone`` says that the other arms of the session have another one.
    """

    series: ReadingSeries | None
    times: Float64
    interpolable: bool = False
    step: float = 1.0
    lag: Lag | None = None
    undetermined: str = ""
    nowhere: bool = False
    curve: LagCurve | None = None
    fixed: bool = False
    alone: bool = False

    @classmethod
    def of(
        cls,
        series: ReadingSeries | None,
        names: Sequence[str],
        outer_std: Float64,
        given: Lag | None = None,
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

        Raises
        ------
        InputError
            The given lag is not known in the unit of the series, or there are no readings to take it out of.
        """
        if series is None or not all(name in series.frames for name in names):
            return cls._without_order(len(names), given)
        low, high = RANGE[series.unit]
        postures = series.unit == "frames" and series.jumps(OUTER_JOINTS, _ROUGH * outer_std)
        interpolable = not postures and series.is_interpolable(OUTER_JOINTS, _ROUGH * outer_std)
        step = max(min(_STEP[series.unit], series.interval), (high - low) / (_MOST_STEPS - 1))
        found = cls(series, np.array([series.frames[name] for name in names]), interpolable, step)
        if given is not None:
            value = given.in_unit(series.unit)
            lag = Lag.of(value, 0.0, series.unit, series.interval, applied=value != 0)
            return replace(found, lag=lag, fixed=True)
        return found if interpolable else replace(found, undetermined=NOT_INTERPOLABLE)

    @classmethod
    def _without_order(cls, frames: int, given: Lag | None) -> SessionLag:
        """Return that of frames without an order, of which only a lag of zero may be given."""
        times = np.full(frames, np.nan)
        if given is not None:
            if given.frames or given.seconds:
                raise InputError(
                    "lag: expected readings of numbered frames, or times of images and readings, got neither"
                )
            return cls(None, times, lag=Lag.of(0.0, 0.0, "frames", 1.0, applied=False), fixed=True)
        return cls(
            None,
            times,
            undetermined="the frames have no order: name them by numbers, or give the times of images (images.csv) and "
            "readings",
        )

    def subset(self, index: Sequence[int] | Indices) -> SessionLag:
        """Return that of the frames at some indices."""
        return replace(self, times=self.times[np.asarray(index, dtype=np.intp)])

    # readings at a lag

    @property
    def _known(self) -> ReadingSeries:
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
        return np.asarray(~np.isnan(self._known.at(OUTER_JOINTS, self.read_times(value))).any(axis=1))

    @property
    def all_have_readings(self) -> bool:
        """Whether each frame has readings of all outer joints at the lag that is taken out."""
        return self.applied is None or bool(self.has_readings(self.value).all())

    def has_readings_near(self) -> Bool:
        """Whether each frame has readings at the lag that is taken out, and half a step of the search around it."""
        reach = self.step / 2 if self.interpolable else 0.0
        return np.asarray(self.has_readings(self.value - reach) & self.has_readings(self.value + reach))

    def corrected(self, model: SessionModel) -> SessionModel:
        """Return a model with the readings of the times of the images less the lag that is taken out."""
        return model if self.applied is None else self._model_at(model, self.value, smoothed=False)

    def model_to_compare(self, model: SessionModel, value: float) -> SessionModel:
        """Return the model with the readings at a lag by which lags are compared.

        Its readings are smoothed where they may be interpolated: otherwise a lag between two rows would agree better
        than one at a row, because it averages the noise of both. The errors of joints that cables move last for
        seconds, so that frames close to each other count as one for these joints: play in the cables would
        otherwise be taken for a lag.
        """
        count = len(self.times)
        spacing = float(np.ptp(self.times)) / max(count - 1, 1) * self._unit_seconds
        factor = float(np.sqrt(np.clip(_CABLE_SECONDS / max(spacing, 1e-9), 1.0, count)))
        own = model.deviations
        outer = own.outer * np.where(np.array(OUTER_JOINTS) == "roll", factor, 1.0)
        wide = replace(own, outer=outer, joints=factor * own.joints)
        return replace(self._model_at(model, value), deviations=wide)

    def _model_at(self, model: SessionModel, value: float, *, smoothed: bool = True) -> SessionModel:
        read, spline = self.read_times(value), smoothed and self.interpolable
        outer = self._known.at(OUTER_JOINTS, read, smoothed=spline)
        joints = self._known.at(model.names, read, smoothed=spline)
        endoscope = model.endoscope
        if isinstance(endoscope, Steered):
            endoscope = endoscope.at(self._known.at(ECM_JOINTS, read))
        return replace(model, outer=outer, joints=joints, endoscope=endoscope)

    # times of the frames

    @property
    def _unit_seconds(self) -> float:
        """Length of the unit of the series, s; images that are only counted are 1 / 30 s apart."""
        return 1.0 if self._known.unit == "s" else _FRAME_SECONDS

    @property
    def _timed(self) -> bool:
        """Whether the time between frames is known.

        Frames that are only counted are taken for consecutive images, but not if their readings jump from row to row:
        then they were picked from a recording, and the time between them is not known.
        """
        return self.series is not None and (self.series.unit == "s" or self.interpolable)

    def seconds(self) -> Float64 | None:
        """Return the times (N,), s, at which the arm was read as the images show it; None where they are not known."""
        return self._unit_seconds * self.read_times(self.value) if self._timed else None

    def play(self, names: Sequence[str], readings: Float64, width: Float64) -> Play | None:
        """Return how far C joints stay behind their readings (N, C); None where the times are not known.

        ``width`` (C,), rad, is that of their play; all readings of the series count.
        """
        if not self._timed:
            return None
        at, of_joints, series = self.read_times(self.value), [], self._known
        for name, column, band in zip(names, readings.T, width, strict=True):
            times, values = series.times.get(name), series.values.get(name)
            if times is None or values is None:
                times, values = np.zeros(1), np.full(1, np.nan)
            of_joints.append(play_between(times, values, float(band), at, column))
        return Play(*(np.stack(part, axis=1) for part in zip(*of_joints, strict=True)))

    # what is known of the lag

    def with_estimate(self, found: Refined | None) -> SessionLag:
        """Return the estimate with a refined lag where that is determined; one that is taken out stays so."""
        lag: Lag | str = "the frames' disagreement has no minimum there, or too few frames have readings"
        if found is not None:
            lag = self.decided(found)
        if isinstance(lag, Lag):
            return replace(self, lag=replace(lag, applied=lag.applied or self.applied is not None))
        return replace(self, undetermined=lag) if self.lag is None else self

    def decided(self, found: Refined) -> Lag | str:
        """Decide whether a lag is to be taken out; a text that says why where it is not determined."""
        (value, std), series = found, self._known
        if std > _LARGEST_STD * series.interval:
            return f"standard deviation {std / series.interval:.1f} frames; {MOVE}"
        significant = abs(value) > max(_SIGNIFICANT * std, _LEAST_LAG * series.interval)
        return Lag.of(value, std, series.unit, series.interval, applied=significant)

    @property
    def known(self) -> tuple[float, float] | None:
        """The lag and its standard deviation in the unit of the series; None where it is not determined."""
        if self.lag is None or self.series is None:
            return None
        std = self.lag.std_seconds if self.series.unit == "s" else self.lag.std_frames
        return None if std is None else (self.lag.in_unit(self.series.unit), std)

    def with_block(self, model: SessionModel, calibration: Calibration) -> tuple[SessionModel, Calibration]:
        """Return a model and a calibration with what is left of the lag as a block.

        There is none where the lag is given, or readings cannot be interpolated. The effect is that of the readings'
        velocity on the arm: errors of the joints that cables move look like a lag themselves. Frames without readings
        there show nothing of it. A lag that is not determined has the standard deviation that the curve shows, but at
        least `_UNDETERMINED` frames.
        """
        if not self.interpolable or self.fixed or self.nowhere:
            return model, calibration
        interval, by = self._known.interval, _LEAST_STEP * self.step
        std = max(self.known[1], _LEAST_PRIOR * interval) if self.known else _UNDETERMINED * interval
        if self.curve is not None:
            std = max(std, self.curve.root_mean_square(len(self.times), _UNKNOWN * interval, self.value))
        alone = calibration.without(LAG)
        later, earlier = (self._model_at(model, self.value + step).predict(alone) for step in (by, -by))
        effect = np.nan_to_num(later.minus(earlier) / (2 * by))
        effect[:, _ROLL_AXIS:] = 0.0
        left = calibration.values.get(LAG, np.zeros(1))
        block = LagBlock(std, shared=not self.alone)
        return replace(model, by_lag=effect), calibration.with_blocks(block, **{LAG: left})

    def after(self, solution: Solved) -> SessionLag:
        """Return the lag after the step of its block, with the standard deviation there.

        It stays as it is where a frame would have no readings.
        """
        place, reach = solution.calibration.place(LAG), self.step / 2
        expected = _SHARED_ERRORS**2 * np.linalg.inv(solution.information)[place, place]
        std = np.sqrt(np.maximum(expected, solution.covariance[place, place])).item()
        value = self.value + float(np.clip(solution.calibration.values[LAG][0], -reach, reach))
        found = self.with_estimate(Refined(value, std))
        return found if found.all_have_readings else self

    # search by the frames' modes

    def searched(self, model: SessionModel, modes: Sequence[Sequence[Mode]]) -> SessionLag:
        """Find the lag from the frames' own modes; arguments as in `find_consensus`."""
        if not self.interpolable or self.fixed:
            return self
        found, best = self._search(model, modes)
        return found if best is None else found.with_estimate(found._at_minimum(best))

    def _at_minimum(self, best: float) -> Refined | None:
        """Return the lag at the minimum of the curve, by a parabola through three points."""
        assert self.curve is not None
        step, lags, misfit = self.step, self.curve.lags, self.curve.misfit
        at = int(np.abs(lags - best).argmin())
        if not 0 < at < len(lags) - 1:
            return None
        before, least, after = misfit[at - 1 : at + 2]
        bend = before - 2 * least + after
        if bend <= 0:
            return None
        std = step * np.sqrt(2 / (_FREEDOM_OF_A_FRAME * len(self.times) * bend))
        return Refined(float(best + 0.5 * step * (before - after) / bend), float(std))

    def _search(self, model: SessionModel, modes: Sequence[Sequence[Mode]]) -> tuple[SessionLag, float | None]:
        """Find the lag at which the frames' modes agree best; None with the reason where they do not determine it.

        Where they agree at no lag of the usual range, the far range is searched too. The lag is not determined by too
        few frames, nor if the best lag is at the end of the range, or the frames agree at none.
        """
        if len(modes) < _LEAST_FRAMES:
            text = f"{len(modes)} frames have a pose and readings, at least {_LEAST_FRAMES} are needed"
            return replace(self, undetermined=text), None
        unit, step, ends = self._known.unit, self.step, tuple[float, ...]()
        low, high = RANGE[unit]
        lags, costs = self._costs(model, modes, low, high, step)
        if not costs.min() <= _DISAGREE:
            low, high = -FARTHEST[unit], FARTHEST[unit]
            coarse, far = self._costs(model, modes, low, high, _COARSE * step)
            if far.min() < costs.min() / UNLIKELY:
                about, ends = float(coarse[far.argmin()]), (low, high)
                near = max(low, about - _COARSE * step), min(high, about + _COARSE * step)
                lags, costs = self._costs(model, modes, *near, step)
        best = int(np.argmin(costs))
        pairs = zip(lags.tolist(), costs.tolist(), strict=True)
        found = replace(self, curve=LagCurve(unit, tuple((lag, cost) for lag, cost in pairs if np.isfinite(cost))))
        if not np.isfinite(costs[best]):
            return replace(found, undetermined="too few frames have readings at any lag"), None
        at_end = min((abs(lags[best] - end) for end in ends), default=np.inf) < _COARSE * step
        nowhere = (at_end or costs[best] > _DISAGREE) if ends else bool(costs[best] > _NOWHERE)
        if nowhere:
            text = (
                f"not determined in the range searched, {low:g} to {high:+g} {unit}: the frames agree at no lag in it; "
                "it may lie beyond (take a first guess out by import --lag, or subtract it from image times)"
            )
            return replace(found, undetermined=text, nowhere=True), None
        if not ends and best in (0, len(lags) - 1):
            text = f"the frames agree best at the end of the range that was searched; {MOVE}"
            return replace(found, undetermined=text), None
        return found, float(lags[best])

    def _costs(
        self, model: SessionModel, modes: Sequence[Sequence[Mode]], low: float, high: float, step: float
    ) -> tuple[Float64, Float64]:
        """Return the lags (L,) of a search and the mean misfits (L,) there; infinite with too few readings."""
        lags = np.asarray(step * np.arange(round(low / step), round(high / step) + 1), np.float64)
        agreed = [self._consensus(model, modes, lag) for lag in lags.tolist()]
        return lags, np.array([np.inf if each is None else each.mean_misfit for each in agreed])

    def _consensus(self, model: SessionModel, modes: Sequence[Sequence[Mode]], value: float) -> Consensus | None:
        """Return the consensus of the frames' modes at a lag; None if too few frames have readings there."""
        has = np.flatnonzero(self.has_readings(value))
        if len(has) < max(_LEAST_AT_LAG, _LEAST_SHARE * len(modes)):
            return None
        few = {"hypothesis_frames": _HYPOTHESIS_FRAMES, "test_frames": _TEST_FRAMES}
        own = [modes[int(i)] for i in has]
        return find_consensus(self.model_to_compare(model, value).subset(has), own, **few)


def in_common(lags: Sequence[SessionLag]) -> list[SessionLag]:
    """Return the lags of a session's arms, of which those that agree become their mean by the standard deviations.

    An arm whose frames do not show its lag has that of the others. A lag that disagrees, or at which few
    frames would have readings, is that of its arm alone: arms may have clocks of their own.
    """
    if len(lags) < 2:
        return list(lags)
    units = {lag.series.unit for lag in lags if lag.series is not None}
    usable = [lag.interpolable and not lag.fixed and (lag.lag is None or lag.known is not None) for lag in lags]
    found = [known for lag, use in zip(lags, usable, strict=True) if use and (known := lag.known) is not None]
    if len(units) != 1 or not all(usable) or not found:
        return [replace(lag, alone=True) for lag in lags]
    values, stds = np.array(found).T
    weights = stds**-2.0
    mean, std = weights @ values / weights.sum(), weights.sum() ** -0.5
    if (np.abs(values - mean) > _AGREE * stds).any():
        return [replace(lag, alone=True) for lag in lags]
    common = Refined(float(mean), float(std))
    shared = [replace(lag, lag=None).with_estimate(common) for lag in lags]
    if not all(lag.lag is not None and lag.has_readings(lag.value).sum() >= _LEAST_AT_LAG for lag in shared):
        return [replace(lag, alone=True) for lag in lags]
    return [replace(lag, undetermined="") for lag in shared]
