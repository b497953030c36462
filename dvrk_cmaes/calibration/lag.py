"""The lag between the images and the joint readings of a session.

The lag is positive if the images are late: the image of time t shows the arm as it was read at t - lag. A wrong lag
gives a moving arm readings of another moment, so that the frames' poses no longer agree on one camera_from_base. The
lag is where they agree best, and the curvature of their disagreement there gives its standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from dvrk_cmaes.calibration.consensus import Consensus, Mode, find_consensus
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.calibration.solve import FrameFits, robust_cost, solve
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.rounding import rounded
from dvrk_cmaes.io.typed_document import Number
from dvrk_cmaes.joints.series import ReadingSeries, Unit

Float64 = NDArray[np.float64]

SIGN = "images late"
_LEAST_FRAMES = 6  # of a session; with fewer, a lag cannot be distinguished from outliers
_LEAST_AT_LAG = 4  # frames that must have readings at a lag
_RANGE = {"frames": (-5.0, 15.0), "s": (-0.25, 0.75)}  # of the search
_STEP = {"frames": 1.0, "s": 1 / 30}  # of the search, at most the time between images
_MOST_STEPS = 61
_LEAST_SHARE = 0.5  # of the frames that must have readings at a lag
_HYPOTHESIS_FRAMES, _TEST_FRAMES = 12, 60  # of each consensus of the search
_REFINEMENTS = 4
_LEAST_STEP = 0.25  # of the refinement's differences, relative to the search's
_ROUGH = 5.0  # standard deviations of a reading that it may change unevenly from row to row
_IMPROVEMENT = 0.5  # largest ratio of mean misfits at which a lag of readings that cannot be interpolated is applied
_SIGNIFICANT = 2.0  # standard deviations
_LEAST_LAG = 0.3  # frames, below which a lag is not corrected
_SHARED_ERRORS = 2.0  # factor on the standard deviation: the frames of a recording share errors of masks and readings
_LARGEST_STD = 1.0  # frames, above which the lag is not determined


class LagDocument(Struct):
    """The lag in ``session.json``; documents without ``sign`` count readings that are late as positive."""

    frames: Number
    seconds: Number | None = None
    std_frames: Number | None = None
    std_seconds: Number | None = None
    sign: str | None = None
    applied: bool = True


@dataclass(frozen=True)
class Lag:
    """Lag of the images behind the readings and its standard deviation, in frames and, if times are known, in seconds.

    ``applied`` tells whether it was taken out of the readings; a lag that does not differ significantly from zero is
    not.
    """

    frames: float
    std_frames: float | None
    seconds: float | None = None
    std_seconds: float | None = None
    applied: bool = True

    @classmethod
    def of(cls, value: float, std: float, unit: Unit, interval: float, *, applied: bool) -> Lag:
        """Create a lag from a value and standard deviation in the unit of a series with a time between images."""
        seconds, std_seconds = (value, std) if unit == "s" else (None, None)
        return cls(value / interval, std / interval, seconds, std_seconds, applied)

    @classmethod
    def from_document(cls, document: LagDocument | None) -> Lag | None:
        """Take a lag from its document."""
        if document is None:
            return None
        sign = 1.0 if document.sign == SIGN else -1.0
        seconds = None if document.seconds is None else sign * document.seconds
        return cls(sign * document.frames, document.std_frames, seconds, document.std_seconds, document.applied)

    def to_dict(self) -> dict[str, Any]:
        """Return the lag in the documented schema, ready for JSON."""
        values = {
            "frames": self.frames,
            "std_frames": self.std_frames,
            "seconds": self.seconds,
            "std_seconds": self.std_seconds,
        }
        numbers = {name: rounded(value) for name, value in values.items() if value is not None}
        return {**numbers, "sign": SIGN, "applied": self.applied}

    def describe(self) -> str:
        """Describe the lag in words: its amount in frames and seconds, its sign, and its standard deviation."""
        amount = f"{abs(self.frames):.2f} frames"
        if self.seconds is not None:
            amount += f" ({abs(self.seconds):.3f} s)"
        std = "" if self.std_frames is None else f", std {self.std_frames:.2f} frames"
        return f"images are {amount} {'later' if self.frames > 0 else 'earlier'} than the readings{std}"


@dataclass(frozen=True, eq=False)
class Clock:
    """Readings of a session's frames at any lag.

    ``times`` (N,) are those of the frames' images on the clock of the ``series``. ``interpolable`` tells whether the
    readings may be interpolated, because the rows follow each other closely in time. ``step`` is that of the search for
    the lag, in the unit of the series; for readings that cannot be interpolated it is the time between their rows, None
    if that is not constant.
    """

    series: ReadingSeries
    times: Float64
    interpolable: bool
    step: float | None

    @classmethod
    def of(cls, series: ReadingSeries, names: Sequence[str], outer_std: Float64) -> Clock:
        """Create the clock of frames in the order of their model; ``outer_std`` (4,) are of the outer readings."""
        low, high = _RANGE[series.unit]
        interpolable = series.is_interpolable(OUTER_JOINTS, _ROUGH * outer_std)
        fine = max(min(_STEP[series.unit], series.interval), (high - low) / (_MOST_STEPS - 1))
        step = fine if interpolable else series.spacing(OUTER_JOINTS[0])
        return cls(series, np.array([series.frames[name] for name in names]), interpolable, step)

    def subset(self, index: Sequence[int] | NDArray[np.integer]) -> Clock:
        """Return the clock of some of the frames."""
        return replace(self, times=self.times[np.asarray(index, dtype=np.intp)])

    def model_at(self, model: SessionModel, lag: float) -> SessionModel:
        """Return the model with the readings of the times of the images less the lag."""
        outer, joints = (self.series.at(names, self.times - lag) for names in (OUTER_JOINTS, model.names))
        return model.of_readings(outer, joints, model.deviations, model.inflation)

    def has_readings(self, lag: float) -> NDArray[np.bool_]:
        """Whether each frame has readings of all outer joints at a lag, (N,)."""
        return np.asarray(~np.isnan(self.series.at(OUTER_JOINTS, self.times - lag)).any(axis=1))


def search_lag(
    clock: Clock, model: SessionModel, modes: Sequence[Sequence[Mode]], offset_std: Float64
) -> tuple[float, Calibration] | None:
    """Find the lag at which the frames' modes agree best, and the calibration on which they agree there.

    The lag is found to a step of the search, in the unit of the series.

    Returns None if there are too few frames or the best lag is at the end of the range. Readings that cannot be
    interpolated must be at regular times, and the lag must halve the mean misfit; otherwise the result is None, too.
    """
    if len(modes) < _LEAST_FRAMES:
        return None
    low, high = _RANGE[clock.series.unit]
    step = clock.step
    if step is None:
        return None
    lags = step * np.arange(round(low / step), round(high / step) + 1)
    found = [_consensus_at(clock, model, modes, offset_std, lag) for lag in lags]
    costs = np.array([np.inf if one is None else one.mean_misfit for one in found])
    best = int(np.argmin(costs))
    synchronous = int(np.argmin(np.abs(lags)))
    if not clock.interpolable and best != synchronous and costs[best] > _IMPROVEMENT * costs[synchronous]:
        return None
    consensus = found[best]
    return None if best in (0, len(lags) - 1) or consensus is None else (float(lags[best]), consensus.calibration)


def _consensus_at(
    clock: Clock, model: SessionModel, modes: Sequence[Sequence[Mode]], offset_std: Float64, lag: float
) -> Consensus | None:
    """Return the consensus of the frames' modes at a lag; None if too few frames have readings there."""
    has = np.flatnonzero(clock.has_readings(lag))
    if len(has) < max(_LEAST_AT_LAG, _LEAST_SHARE * len(modes)):
        return None
    return find_consensus(
        clock.model_at(model, lag).subset(has),
        [modes[int(i)] for i in has],
        offset_std,
        hypothesis_frames=_HYPOTHESIS_FRAMES,
        test_frames=_TEST_FRAMES,
    )


def refine_lag(
    clock: Clock,
    model: SessionModel,
    fits: FrameFits,
    calibration: Calibration,
    prior: Float64,
    start: float,
) -> tuple[float, float] | None:
    """Refine a lag to a fraction of a step, and estimate its standard deviation, both in the unit of the series.

    The calibration is solved at three lags at a time; the minimum of the parabola through the three robust costs is
    the next lag. Only frames with readings within a step on either side of the start are used. Returns None if there
    are too few, or if the cost has no minimum there. A lag of readings that cannot be interpolated is left as it is.
    """
    step, lag = clock.step, start
    if step is None:
        return None
    if not clock.interpolable:
        return lag, float(step / np.sqrt(12))
    has = np.flatnonzero(clock.has_readings(start - step) & clock.has_readings(start + step))
    if len(has) < _LEAST_AT_LAG:
        return None
    near, used, outlines = clock.subset(has), model.subset(has), fits.subset(has)

    def cost(at: float) -> float:
        shifted = near.model_at(used, at)
        return robust_cost(solve(shifted, outlines, calibration, prior).misfit, 6 + len(model.names))

    width = step
    for _ in range(_REFINEMENTS):
        before, here, after = cost(lag - width), cost(lag), cost(lag + width)
        curvature = (before - 2 * here + after) / width**2
        if curvature <= 0:
            return None
        lag += float(np.clip((before - after) / (2 * width * curvature), -width, width))
        lag = float(np.clip(lag, start - step / 2, start + step / 2))
        width = max(width / 2, _LEAST_STEP * step)
        if abs(lag - start) + width > step:
            width = step - abs(lag - start)
    return lag, _SHARED_ERRORS * float(np.sqrt(2 / curvature))


def describe_lag(clock: Clock, lag: float, std: float) -> Lag | None:
    """Decide whether a lag is to be corrected; None where it is not determined."""
    interval = clock.series.interval
    if std > _LARGEST_STD * interval:
        return None
    significant = abs(lag) > max(_SIGNIFICANT * std, _LEAST_LAG * interval)
    return Lag.of(lag, std, clock.series.unit, interval, applied=significant)
