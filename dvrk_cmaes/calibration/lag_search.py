"""Search for the lag at which the frames' own modes agree best, and its estimate there with base and offsets.

The estimate has the lag as a block: a change of it changes what is predicted of a frame by the velocity of its
readings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration, PredictedBlock
from dvrk_cmaes.calibration.consensus import Consensus, agreement, find_consensus
from dvrk_cmaes.calibration.lag import FRAME_SECONDS, LEAST_AT_LAG, MOVE, LagCurve, SessionLag
from dvrk_cmaes.calibration.model import ROLL, SessionModel
from dvrk_cmaes.calibration.session_problem import ArmSession
from dvrk_cmaes.calibration.solve import ArmFrames, FrameFits, solve_arms
from dvrk_cmaes.geometry import Float64

LAG: Final = "lag"
"""Name of the block."""
RANGE: Final = {"frames": (-5.0, 15.0), "s": (-0.25, 0.75)}
"""Least and largest lag of the search, by unit."""
FARTHEST: Final = {"frames": 90.0, "s": 3.0}
"""Largest lag of the search, in either direction, where the frames agree at no lag in `RANGE`."""
UNLIKELY: Final = 1.5
"""Ratio to the least misfit, from which on a lag is unlikely."""

_MOST_STEPS = 61
_CABLE_SECONDS = 2.0  # for which the errors of the joints that cables move stay alike
_LEAST_FRAMES = 6  # of a session; with fewer, a lag cannot be distinguished from outliers
_LEAST_SHARE = 0.5  # of the frames, that must have readings at a lag
_HYPOTHESIS_FRAMES, _TEST_FRAMES = 12, 60  # of each consensus
_DISAGREE = 2.0  # mean misfit, of at most 4, from which on the frames agree hardly, and a lag is looked for far away
_NOWHERE = 3.0  # mean misfit from which on most frames disagree, and the best lag is one by chance
_COARSE = 3  # steps, in each of the far search: the misfit falls over many times as much
_APART = 1.8  # times the least misfit, at least, between minima that are no flat one
_DIFFERENCE = 0.25  # steps, by which readings are shifted for derivatives
_NEAR = 2.0  # steps, by which an estimate is at most from where the frames agree best


class LagBlock(PredictedBlock):
    """A lag (1,), in the unit of the frames' times, by the model of the frames' readings ``at`` it.

    Derivatives are differences of what is predicted a ``step`` before and after.
    """

    def __init__(self, std: float, at: Callable[[float], SessionModel], step: float) -> None:
        super().__init__(LAG, np.array([std]))
        self._at, self._step = at, step

    def change(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes of the predictions by the lag."""
        alone = calibration.alone(without=LAG)
        return self._at(calibration.values[LAG].item()).predict(alone).minus(model.predict(alone))

    def derivative(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes of the predictions by those of the readings."""
        alone, value = calibration.alone(without=LAG), calibration.values[LAG].item()
        later, earlier = (self._at(value + by).predict(alone) for by in (self._step, -self._step))
        return later.minus(earlier)[:, :, None] / (2 * self._step)


def find_lag(arm: ArmSession) -> SessionLag:
    """Find the lag of an arm's frames; as it is known, where it was given or readings are not interpolable.

    Where the frames agree at no lag of the usual range, the far range is searched too. The lag is not determined by too
    few frames, nor if the best lag is at the end of the range, or the frames agree at none.
    """
    known = arm.lag
    if not known.interpolable or known.fixed:
        return known
    if len(arm.frames) < _LEAST_FRAMES:
        text = f"{len(arm.frames)} frames have a pose and readings, at least {_LEAST_FRAMES} are needed"
        return replace(known, undetermined=text)
    unit, step, ends = known.readings.unit, _step(known), tuple[float, ...]()
    low, high = RANGE[unit]
    lags, costs = _costs(arm, low, high, step)
    if not costs.min() <= _DISAGREE:
        low, high = -FARTHEST[unit], FARTHEST[unit]
        coarse, far = _costs(arm, low, high, _COARSE * step)
        if far.min() < costs.min() / UNLIKELY:
            about, ends = float(coarse[far.argmin()]), (low, high)
            lags, costs = _costs(arm, max(low, about - _COARSE * step), min(high, about + _COARSE * step), step)
    best, finite = int(np.argmin(costs)), np.flatnonzero(np.isfinite(costs))
    points = tuple(zip(lags[finite].tolist(), costs[finite].tolist(), strict=True))
    curve = LagCurve(unit, points, known.independent)
    at_end = min((abs(lags[best] - end) for end in ends), default=np.inf) < _COARSE * step
    nowhere = (at_end or costs[best] > _DISAGREE) if ends else bool(_NOWHERE < costs[best] < np.inf)
    between = [costs[min(k, best) : max(k, best) + 1].max() for k in range(len(costs))]
    alike = (costs < UNLIKELY * costs[best]) & (between > _APART * costs[best])
    text = ""
    if not len(finite):
        text = "too few frames have readings at any lag"
    elif nowhere:
        text = (
            f"not determined in the range searched, {low:g} to {high:+g} {unit}: the frames agree at no lag in it; "
            "it may lie beyond (take a first guess out by import --lag, or subtract it from image times)"
        )
    elif not ends and best in finite[[0, -1]]:
        text = f"the frames agree best at the end of the range that was searched; {MOVE}"
    elif alike.any():
        other = lags[np.argmin(np.where(alike, costs, np.inf))]
        text = (
            f"the frames agree about as well at {lags[best]:.3g} and {other:.3g} {unit}, as in a motion that "
            "repeats itself: --lag, if it is known, or a recording of another motion"
        )
    found = replace(known, curve=curve, undetermined=text, nowhere=bool(nowhere))
    if text:
        return found
    estimate = _estimate(arm, float(lags[best]), step)
    return found.with_estimate(estimate, shown=estimate is not None and curve.shows(estimate[0], len(arm.frames)))


def _step(lag: SessionLag) -> float:
    """Return the time between lags that are compared, in the unit of the readings."""
    low, high = RANGE[lag.readings.unit]
    return max(min(FRAME_SECONDS / lag.unit_seconds, lag.readings.interval), (high - low) / (_MOST_STEPS - 1))


def _costs(arm: ArmSession, low: float, high: float, step: float) -> tuple[Float64, Float64]:
    """Return the lags (L,) of a search and the mean misfits (L,) there; infinite with too few readings."""
    lags = np.asarray(step * np.arange(round(low / step), round(high / step) + 1), np.float64)
    agreed = [_consensus(arm, lag) for lag in lags.tolist()]
    return lags, np.array([np.inf if each is None else each.mean_misfit for each in agreed])


def _consensus(arm: ArmSession, value: float) -> Consensus | None:
    """Return the consensus of the frames' modes at a lag; None if too few frames have readings there."""
    has = np.flatnonzero(arm.lag.has_readings(value))
    if len(has) < max(LEAST_AT_LAG, _LEAST_SHARE * len(arm.frames)):
        return None
    there = replace(arm, model=_model_at(arm, value)).subset(has)
    return find_consensus(there, hypothesis_frames=_HYPOTHESIS_FRAMES, test_frames=_TEST_FRAMES)


def _model_at(arm: ArmSession, value: float) -> SessionModel:
    """Return the model of the readings at a lag, by which lags are compared.

    Its readings are smoothed: otherwise a lag between two rows would agree better than one at a row, because it
    averages the noise of both. The errors of joints that cables move last for seconds, so that frames close to each
    other count as one for these joints: play in the cables would otherwise be taken for a lag.
    """
    count, own = len(arm.frames), arm.model.deviations
    spacing = float(np.ptp(arm.lag.times)) / max(count - 1, 1) * arm.lag.unit_seconds
    factor = float(np.sqrt(np.clip(_CABLE_SECONDS / max(spacing, 1e-9), 1.0, count)))
    wide = np.concatenate([own[:ROLL], factor * own[ROLL:-6], own[-6:]])
    return replace(arm.lag.model_at(arm.model, value, smoothed=True), deviations=wide)


def _estimate(arm: ArmSession, start: float, step: float) -> tuple[float, float] | None:
    """Estimate the lag near that of the search with the calibration, by the modes that agree there.

    The standard deviation is that of as many frames as err independently. None if too few frames have readings
    around it, or they agree best nowhere near.
    """
    consensus, near, known = _consensus(arm, start), _NEAR * step, arm.lag
    has = np.flatnonzero(known.has_readings(start - near) & known.has_readings(start + near))
    if consensus is None or len(has) < LEAST_AT_LAG:
        return None
    own = arm.subset(has[np.argsort(known.times[has], kind="stable")])
    chosen = agreement(replace(own, model=own.lag.model_at(own.model, start)), consensus.calibration).chosen
    alike = len(has) / own.lag.independent
    block = LagBlock(FARTHEST[known.readings.unit] / np.sqrt(alike), partial(_model_at, own), _DIFFERENCE * step)
    begun = consensus.calibration.with_blocks(block, **{LAG: np.array([start])})
    (solution,) = solve_arms([ArmFrames(_model_at(own, start), FrameFits.of_modes(own, chosen), begun)])
    place, value = begun.place(LAG), solution.calibration.values[LAG].item()
    if not abs(value - start) < near - _DIFFERENCE * step:
        return None
    alone = alike * np.linalg.inv(solution.information)[place, place]
    return value, float(np.sqrt(max(alone.item(), solution.covariance[place, place].item())))
