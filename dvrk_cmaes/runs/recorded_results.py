"""Results of a recording's frames: their fits smoothed over time, judged, and described as rows of tracks.jsonl."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_task import Run
from dvrk_cmaes.calibration.mask_margin import SessionMasks
from dvrk_cmaes.calibration.solve import robust_weights
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Posed, apply, inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.expected_error import expected_error, locate_tips
from dvrk_cmaes.results.tracked import TrackResult, TrackStatus
from dvrk_cmaes.runs.recorded import Prediction
from dvrk_cmaes.runs.recorded_keyframes import RecordedFrames
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.offset_smoother import smooth
from dvrk_cmaes.track.recorded_frames import EMPTY, FittedFrame, JudgedFrame, JudgeTask, judge_frame
from dvrk_cmaes.track.still_readings import commanded_joints, describe_frozen

Float64 = NDArray[np.float64]

CORRELATED_FRAMES = 3.0
"""Frames near each other whose masks err alike: what each tells counts as much less beside its neighbours."""

_OVERLAP_LOSS = 0.1  # below that of the keyframes, from which on a mask is not explained; neighbours support the pose,
_CONTOUR_FACTOR, _LARGEST_PX = 3.0, 6.0  # so the limits are wider than those of a single frame
_LEAST_OVERLAP = 0.5  # intersection over union below which a mask does not support a pose
_CALIBRATION_ERROR = 2.0  # factor on the calibration's covariance, for errors that all masks of a recording share
_MARGIN_PX = 0.08  # of all masks, beyond what the keyframes tell: rounded corners, a segmenter's threshold
_MEDIAN_TO_STD = 1.4826


@dataclass(frozen=True, eq=False)
class SmoothedFrames:
    """Poses of N frames after smoothing, with covariances (N, D, D), and the fits' squared misfits (N,) per parameter.

    The covariances include those of the calibration.
    """

    at: list[Posed]
    covariance: Float64
    misfit: Float64


def smooth_frames(
    recorded: RecordedFrames,
    predicted: Prediction,
    fits: Sequence[FittedFrame | None],
    session: SessionCalibration,
    instrument: Instrument,
) -> SmoothedFrames:
    """Smooth the deviations of N frames from their predictions; a fit that disagrees counts less, or not at all."""
    count, size = predicted.prior.shape[:2]
    information, optimum, misfit = np.zeros((count, size, size)), np.zeros((count, size)), np.zeros(count)
    calibrated = _CALIBRATION_ERROR * session.covariance_given_camera
    spread = predicted.prior + predicted.jacobian @ calibrated @ np.swapaxes(predicted.jacobian, 1, 2)
    for i, fitted in enumerate(fits):
        if fitted is None:
            continue
        fit, deviation = fitted.fit, fitted.fit.at.minus(predicted.at[i])
        own = np.linalg.pinv(fit.information, rcond=1e-9, hermitian=True)
        least = deviation - own @ fit.slope
        misfit[i] = float(least @ np.linalg.solve(spread[i] + own, least)) / size
        weight = float(robust_weights(misfit[i : i + 1] * size, size)[0])
        weight /= fitted.inflation * CORRELATED_FRAMES
        if not fit.explains_mask:
            weight = 0.0
        information[i] = weight * fit.information
        optimum[i] = weight * (fit.information @ deviation - fit.slope)
    smoothed = smooth(recorded.times, predicted.prior, information, optimum, predicted.jacobian)
    response = smoothed.response
    covariance = smoothed.covariance + response @ calibrated @ np.swapaxes(response, 1, 2)
    at = [predicted.at[i].moved(smoothed.deviations[i]) for i in range(count)]
    camera = session.corrected(recorded.rig.views[0].camera)
    covariance += np.array([_of_margin(one, session.masks, camera, instrument) for one in at])
    return SmoothedFrames(at, covariance, misfit)


def _of_margin(at: Posed, masks: SessionMasks | None, camera: Camera, instrument: Instrument) -> Float64:
    """Return the covariance (D, D) of a pose by a margin that all masks share: the tool seems nearer or farther.

    A shaft that looks wider by twice the margin is nearer in the same proportion.
    """
    size = 6 + len(at.joints)
    if instrument.shaft is None:
        return np.zeros((size, size))
    margin = _MARGIN_PX**2
    if masks is not None:  # what was found but is not clear counts as one more standard deviation, at most
        left = min(abs(masks.margin_px - masks.taken_off), masks.std_margin_px)
        margin += masks.std_margin_px**2 + left**2
    tips = apply(at.pose, instrument.ends(at.joints)).mean(axis=0)
    distance = float(np.linalg.norm(tips))
    width = camera.fx * 2 * instrument.shaft.radius / distance
    along = np.zeros(size)
    along[:3] = at.pose[:3, :3].T @ tips * 2 / width
    return np.asarray(margin * np.outer(along, along))


def judge_all(
    smoothed: SmoothedFrames,
    fits: Sequence[FittedFrame | None],
    predicted: Prediction,
    run: Run[Any, Any],
) -> list[JudgedFrame | None]:
    """Judge the smoothed pose of every frame that shows the instrument."""
    tasks = [
        JudgeTask(fitted.stored, smoothed.at[i], smoothed.covariance[i], predicted.readings[i])
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
) -> list[TrackResult]:
    """Describe the frames as results, in order."""
    frozen = describe_frozen(recorded.frozen, [own.name for own in recorded.files])
    base_from_root = predicted.model.base_from_root(predicted.calibration.offsets)
    results = []
    for i, one in enumerate(judged):
        status, reasons = _status(one, smoothed.misfit[i], session, config)
        if not predicted.told[i]:
            reasons.append("no readings: none of the outer joints at the time of the image less the lag")
        if (text := frozen[i]) is not None:
            reasons.append(text)
        if reasons and status == "ok":
            status = "doubtful"
        fitted = fits[i]
        results.append(
            _result(
                float(recorded.times[i]),
                status,
                tuple(reasons),
                smoothed.at[i],
                smoothed.covariance[i],
                np.asarray(smoothed.at[i].pose @ inverse(base_from_root[i])),
                _offsets(predicted, smoothed.at[i], i),
                body.instrument,
                recorded,
                seconds=0.0 if fitted is None else fitted.seconds,
                residual=None if one is None else _MEDIAN_TO_STD * one.quality.contour_px_median,
            )
        )
    return results


def _status(
    judged: JudgedFrame | None, misfit: float, session: SessionCalibration, config: EstimateConfig
) -> tuple[TrackStatus, list[str]]:
    """Return the status of a frame by its mask alone, and the reasons."""
    if judged is None:
        return "lost", [EMPTY]
    quality = judged.quality
    if quality.iou < _LEAST_OVERLAP:
        return "lost", [f"lost: the mask does not support the pose (IoU {quality.iou:.2f})"]
    reasons = list(judged.reasons)
    largest_px = max(_LARGEST_PX, _CONTOUR_FACTOR * session.contour_px_95)
    if quality.iou < session.iou - _OVERLAP_LOSS or quality.contour_px_95 > largest_px:
        reasons.append(
            f"mask not explained: IoU {quality.iou:.3f}, {quality.contour_px_95:.1f} px at 95 % of the contour, of "
            f"keyframes {session.iou:.3f} and {session.contour_px_95:.1f} px"
        )
    if misfit > config.session.largest_misfit:
        reasons.append(
            f"disagrees with the recording: the mask is {misfit**0.5:.1f} times the expected error from what the "
            "calibration and the readings expect"
        )
    return "doubtful" if reasons else "ok", reasons


def _offsets(predicted: Prediction, at: Posed, i: int) -> dict[str, float]:
    """Return the offsets of roll and the joints of a frame that were read: true = reading + offset."""
    model, offsets = predicted.model, predicted.calibration.offsets
    turned = float(at.minus(predicted.at[i])[5])
    found = {"roll": float(offsets[1] + model.correction.values[i, 0]) + turned}
    for name, value, read in zip(model.names, at.joints, model.joints[i], strict=True):
        if not np.isnan(read):
            found[name] = float(value - read)
    return found


def _result(
    time: float,
    status: TrackStatus,
    reasons: tuple[str, ...],
    at: Posed,
    covariance: Float64,
    base: Float64,
    offsets: Mapping[str, float],
    instrument: Instrument,
    recorded: RecordedFrames,
    *,
    seconds: float,
    residual: float | None,
) -> TrackResult:
    """Return a frame's result with the error that is expected of its tips."""
    tips, _ = locate_tips(instrument, recorded.rig.views[0].camera, at)
    error = expected_error(instrument, at, covariance).tip_mm
    each = [value for name, value in error.items() if name != "mean"]
    return TrackResult(
        time=time,
        status=status,
        reasons=reasons,
        camera_from_root=at.pose,
        joints=dict(zip(instrument.joint_names, at.joints.tolist(), strict=True)),
        covariance=covariance,
        tips=np.array(tips),
        tip_std_mm=float(np.mean(each)) if instrument.jaw_tips else None,
        camera_from_base=base,
        offsets=dict(offsets),
        seconds=seconds,
        residual_px=residual,
    )


def remarks_on_readings(predicted: Prediction) -> list[str]:
    """Describe readings that are told apart: joints that stay constant while the arm moves are commanded values."""
    model = predicted.model
    return [
        f"reading of {name}: constant while the arm moves, taken for a commanded value"
        for name in commanded_joints(model.outer, model.joints, model.names)
    ]
