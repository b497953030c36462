"""Every frame of a recording, given the calibration of its keyframes: fitted, smoothed over time, and judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_task import Run
from dvrk_cmaes.calibration.model import Calibration, SessionModel, outer_readings
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.joints.sparse import LEAST_ERROR, Sparseness
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.runs.recorded_keyframes import RecordedFrames, read_shown
from dvrk_cmaes.track.recorded_frames import (
    BlockTask,
    FittedFrame,
    PredictedFrame,
    fit_block,
)

Float64 = NDArray[np.float64]

BLOCK: Final = 10
"""Consecutive frames that are fitted one after the other by one process."""

_CONTINUED: Final = 6  # frames beyond the first or last readings, as far as these are taken to go on
_UNTOLD_M, _UNTOLD_RAD = 0.01, 0.2  # standard deviations of the arm's motion where its readings are missing or frozen


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the calibration predicts of N frames.

    ``prior`` (N, D, D) is the covariance of the frames' deviations, ``jacobian`` (N, D, K) the change of the
    predictions with the calibration, ``readings`` are by frame, less the lag; ``told`` (N,) whether there are those of
    the outer joints, and ``sparse`` (N,) how far these may be off between readings.
    """

    model: SessionModel
    calibration: Calibration
    at: Posed
    prior: Float64
    jacobian: Float64
    readings: list[dict[str, float]]
    told: NDArray[np.bool_]
    sparse: list[Sparseness]


def predict(recorded: RecordedFrames, session: SessionCalibration, joint_names: tuple[str, ...]) -> Prediction:
    """Predict all frames from their readings less the lag.

    A frame without readings is predicted by those nearest in time, with a wide standard deviation; near the beginning
    and the end of the readings, by what they did there.
    """
    readings = _late_readings(recorded.files, recorded.series, session)
    outer = outer_readings(readings)
    joints = np.array([[own.get(name, np.nan) for name in joint_names] for own in readings])
    told = np.asarray(~np.isnan(outer).any(axis=1))
    known = np.flatnonzero(told)
    nearest = known[np.abs(np.arange(len(told))[:, None] - known).argmin(axis=1)]
    outer, joints = (_continued(values, recorded.times, told, nearest) for values in (outer, joints))
    model, calibration = session.model(outer, joints, joint_names)
    prior = model.covariance(calibration)
    wide = np.diag([_UNTOLD_M**2] * 3 + [_UNTOLD_RAD**2] * (3 + len(joint_names)))
    trusted = told & ~recorded.frozen
    prior[~trusted] += wide
    at, sparse = model.predict(calibration), _sparseness(recorded, session)
    errors = np.array([one.error for one in sparse])
    for joint in np.flatnonzero((errors > LEAST_ERROR).any(axis=0)):
        moved = outer + errors * np.eye(len(OUTER_JOINTS))[joint]
        off_model, off_calibration = session.model(moved, joints, joint_names)
        displaced = off_model.predict(off_calibration)
        for i in np.flatnonzero(errors[:, joint] > LEAST_ERROR).tolist():
            off = displaced[i].minus(at[i])
            prior[i] += np.outer(off, off)
    return Prediction(model, calibration, at, prior, model.jacobian(calibration), readings, told, sparse)


def _continued(values: Float64, times: Float64, told: NDArray[np.bool_], nearest: NDArray[np.intp]) -> Float64:
    """Return the readings (N, K) at all frames: those of the nearest one that has any, or as they go on from there."""
    found = values[nearest]
    for i in np.flatnonzero(~told):
        near = int(nearest[i])
        inner = near + (1 if near > i else -1)
        if abs(i - near) > _CONTINUED or not 0 <= inner < len(told) or not told[inner]:
            continue
        rate = (values[near] - values[inner]) / (times[near] - times[inner])
        found[i] += rate * (times[i] - times[near])
    return found


def _late_readings(
    files: Sequence[FrameFiles], series: ReadingSeries | None, session: SessionCalibration
) -> list[dict[str, float]]:
    """Return the readings of frames at the times of their images less the lag, if that was taken out."""
    lag = session.applied_lag
    if lag is None or series is None:
        return [dict(own.readings) for own in files]
    return [series.of_frame(own.name, lag) if own.name in series.frames else {} for own in files]


def _sparseness(recorded: RecordedFrames, session: SessionCalibration) -> list[Sparseness]:
    """Return for each of N frames how far its readings may be off between those that were taken."""
    series, lag = recorded.series, session.applied_lag
    stamps = None if series is None or series.unit != "s" else series.times.get(OUTER_JOINTS[0])
    if series is None or stamps is None or not set(OUTER_JOINTS) <= set(series.times):
        return [Sparseness.none()] * len(recorded.files)
    values, found = series.at(OUTER_JOINTS, stamps), []
    read = ~np.isnan(values).any(axis=1)
    for own in recorded.files:
        time = series.frames.get(own.name, np.nan)
        late = 0.0 if lag is None or np.isnan(time) else float(lag.at(np.array([time]) + series.origin, series.unit)[0])
        known = bool(read.any()) and not np.isnan(time)
        found.append(Sparseness.of(stamps[read], values[read], time - late) if known else Sparseness.none())
    return found


def fit_all(
    recorded: RecordedFrames,
    session: SessionCalibration,
    predicted: Prediction,
    run: Run[Any, Any],
) -> list[FittedFrame | None]:
    """Fit every frame with the prediction as its prior."""
    information = np.linalg.inv(spread_of(predicted, session))
    rig = Rig(session.corrected_views(recorded.rig.views))  # a task needs no more of the recording and its calibration
    frames = [
        PredictedFrame(own.name, partial(read_shown, own, rig), Expected(predicted.at[i], information[i]))
        for i, own in enumerate(recorded.files)
    ]
    tasks = [BlockTask(tuple(frames[k : k + BLOCK]), session.masks) for k in range(0, len(frames), BLOCK)]
    return [fitted for block in run(fit_block, tasks) for fitted in block]


def spread_of(predicted: Prediction, session: SessionCalibration) -> Float64:
    """Return the covariances (N, D, D) of the frames about their predictions, with that of the calibration."""
    jacobian = predicted.jacobian
    return np.asarray(
        predicted.prior + jacobian @ session.covariance_given_camera @ np.swapaxes(jacobian, 1, 2), np.float64
    )
