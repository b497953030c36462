"""Results of a recording's frames: their fits smoothed over time, judged, and described as rows of tracks.jsonl."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_task import Run
from dvrk_cmaes.calibration.session_camera import covariance_of_camera
from dvrk_cmaes.calibration.session_doubts import resting_on
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Posed, inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.runs.recorded import Prediction
from dvrk_cmaes.runs.recorded_keyframes import RecordedFrames
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.calibrated_frames import (
    Told,
    calibration_covariance,
    covariance_of_margin,
    describe,
    status_of,
)
from dvrk_cmaes.track.offset_smoother import FrameDeviations
from dvrk_cmaes.track.recorded_frames import FittedFrame, JudgedFrame, JudgeTask, judge_frame
from dvrk_cmaes.track.still_readings import describe_frozen

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SmoothedFrames:
    """Poses of N frames after smoothing, with covariances (N, D, D), and the fits' squared misfits (N,) per parameter.

    The covariances include those of the calibration.
    """

    at: list[Posed]
    covariance: Float64
    misfit: Float64


@dataclass(frozen=True, eq=False)
class Beside:
    """Fits of N frames by other evidence, and its weight beside the first one, at most 1."""

    fits: Sequence[FittedFrame | None]
    weight: float


def smooth_frames(
    recorded: RecordedFrames,
    predicted: Prediction,
    fits: Sequence[FittedFrame | None],
    session: SessionCalibration,
    instrument: Instrument,
    beside: Beside | None = None,
) -> SmoothedFrames:
    """Smooth the deviations of N frames from their predictions; a fit that disagrees counts less, or not at all.

    ``beside`` are fits of the same frames by other evidence.
    """
    count, size = predicted.prior.shape[:2]
    information, optimum, misfit = np.zeros((count, size, size)), np.zeros((count, size)), np.zeros(count)
    calibrated = calibration_covariance(session)
    spread = predicted.prior + predicted.jacobian @ calibrated @ np.swapaxes(predicted.jacobian, 1, 2)
    for i, fitted in enumerate(fits):
        told = Told.of(fitted, predicted.at[i], spread[i])
        information[i], optimum[i], misfit[i] = told.information, told.optimum, told.misfit
        if beside is not None:
            other = Told.of(beside.fits[i], predicted.at[i], spread[i])
            information[i] += beside.weight * other.information
            optimum[i] += beside.weight * other.optimum
    smoothed = FrameDeviations.of(recorded.times, predicted.prior, information, optimum, predicted.jacobian).smoothed()
    response = smoothed.response
    covariance = smoothed.covariance + response @ calibrated @ np.swapaxes(response, 1, 2)
    at = [predicted.at[i].moved(smoothed.deviations[i]) for i in range(count)]
    camera = session.corrected(recorded.rig.views[0].camera)
    covariance += np.array([covariance_of_margin(one, session.masks, camera, instrument) for one in at])
    covariance += np.array([covariance_of_camera(session.camera, one, camera) for one in at])
    return SmoothedFrames(at, covariance, misfit)


def judge_all(
    smoothed: SmoothedFrames,
    fits: Sequence[FittedFrame | None],
    run: Run[Any, Any],
) -> list[JudgedFrame | None]:
    """Judge the smoothed pose of every frame that shows the instrument."""
    tasks = [
        JudgeTask(fitted.stored, smoothed.at[i], smoothed.covariance[i])
        for i, fitted in enumerate(fits)
        if fitted is not None
    ]
    judged = iter(run(judge_frame, tasks))
    return [None if fitted is None else next(judged) for fitted in fits]


def results_of(
    recorded: RecordedFrames,
    session: SessionCalibration,
    predicted: Prediction,
    fits: Sequence[FittedFrame | None],
    smoothed: SmoothedFrames,
    judged: Sequence[JudgedFrame | None],
    body: Body,
    config: EstimateConfig,
    source: str = "mask",
) -> list[TrackResult]:
    """Describe the frames as results, in order; ``source`` is what the evidence is taken from, for reasons."""
    frozen = describe_frozen(recorded.frozen, [own.name for own in recorded.files])
    base_from_root = predicted.model.base_from_root(predicted.calibration.offsets)
    remarks, results = recorded.rig.remarks, []
    for i, one in enumerate(judged):
        status, reasons = status_of(one, smoothed.misfit[i], session, config, source)
        if (of_image := fits[i]) is not None:
            reasons += of_image.doubts
        if not predicted.told[i]:
            reasons.append("no readings: none of the outer joints at the time of the image less the lag")
        if predicted.sparse[i].reason:
            reasons.append(predicted.sparse[i].reason)
        if (text := frozen[i]) is not None:
            reasons.append(text)
        if reasons and status == "ok":
            status = "doubtful"
        fitted = fits[i]
        result = describe(
            float(recorded.times[i]),
            status,
            tuple(reasons),
            smoothed.at[i],
            smoothed.covariance[i],
            np.asarray(smoothed.at[i].pose @ inverse(base_from_root[i])),
            _offsets(predicted, smoothed.at[i], i),
            body.instrument,
            recorded.rig.views[0].camera,
            seconds=0.0 if fitted is None else fitted.seconds,
            judged=one,
        )
        results.append(resting_on(replace(result, remarks=remarks), session))
    return results


def _offsets(predicted: Prediction, at: Posed, i: int) -> dict[str, float]:
    """Return the offsets of roll and the joints of a frame that were read: true = reading + offset."""
    model, offsets = predicted.model, predicted.calibration.offsets
    turned = float(at.minus(predicted.at[i])[5])
    found = {"roll": float(offsets[1] + model.correction.values[i, 0]) + turned}
    for name, value, read in zip(model.names, at.joints, model.joints[i], strict=True):
        if not np.isnan(read):
            found[name] = float(value - read)
    return found
