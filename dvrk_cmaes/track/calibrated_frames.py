"""What the fit of one image to the prediction of a calibration tells, and the result that follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.session_masks import SessionMasks
from dvrk_cmaes.calibration.solve import robust_weights
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN
from dvrk_cmaes.geometry import Posed, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.expected_error import expected_error, locate_tips
from dvrk_cmaes.results.result import ExpectedError
from dvrk_cmaes.results.tracked import TrackResult, TrackStatus
from dvrk_cmaes.track.quick_fit import QuickFit
from dvrk_cmaes.track.recorded_frames import EMPTY, FittedFrame, JudgedFrame

Float64 = NDArray[np.float64]

CORRELATED_FRAMES = 3.0
"""Frames near each other whose masks err alike: what each tells counts as much less beside its neighbours."""

OVERLAP_LOSS = 0.15
"""Loss of overlap from that of the keyframes, from which on a mask is not explained."""

# Neighbours support the pose, so these limits are wider than those of a single frame.
_CONTOUR_FACTOR, _LARGEST_PX = 3.0, 9.0
_LEAST_OVERLAP = 0.5  # intersection over union below which a mask does not support a pose
_CALIBRATION_ERROR = 1.3  # factor on the calibration's covariance, for errors that all masks of a recording share
_MARGIN_PX = 0.08  # of all masks, beyond what the keyframes tell: rounded corners, a segmenter's threshold


@dataclass(frozen=True, eq=False)
class Told:
    """What a fit tells of a frame's deviation from its prediction.

    ``information`` (D, D) and ``optimum`` (D,) are those of `FrameDeviations.of`, zero where it tells nothing;
    ``misfit`` is the squared misfit per parameter.
    """

    information: Float64
    optimum: Float64
    misfit: float

    @classmethod
    def of(cls, fitted: FittedFrame | QuickFit | None, predicted: Posed, spread: Float64) -> Told:
        """Weigh a fit by how it agrees with the prediction, whose covariance is ``spread`` (D, D)."""
        size = len(spread)
        if fitted is None:
            return cls(np.zeros((size, size)), np.zeros(size), 0.0)
        fit, deviation = fitted.fit, fitted.fit.at.minus(predicted)
        own = np.linalg.pinv(fit.information, rcond=1e-9, hermitian=True)
        least = deviation - own @ fit.slope
        misfit = float(least @ np.linalg.solve(spread + own, least)) / size
        weight = float(robust_weights(np.array([misfit * size]), size)[0])
        weight /= fitted.inflation * CORRELATED_FRAMES
        if not fit.explains_mask:
            weight = 0.0
        return cls(weight * fit.information, weight * (fit.information @ deviation - fit.slope), misfit)


def calibration_covariance(session: SessionCalibration) -> Float64:
    """Return the covariance (K, K) of a calibration, widened for errors that all masks of a recording share."""
    return np.asarray(_CALIBRATION_ERROR * session.covariance_given_camera)


def covariance_of_margin(at: Posed, masks: SessionMasks | None, camera: Camera, instrument: Instrument) -> Float64:
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


def mean_of_tips_mm(instrument: Instrument, error: ExpectedError) -> float | None:
    """Return the mean of the tips' expected errors, mm; None for an instrument without tips."""
    each = [value for name, value in error.tip_mm.items() if name != "mean"]
    return float(np.mean(each)) if instrument.jaw_tips else None


def status_of(
    judged: JudgedFrame | None,
    misfit: float,
    session: SessionCalibration,
    config: EstimateConfig,
    source: str = "mask",
) -> tuple[TrackStatus, list[str]]:
    """Return the status of a frame by its mask alone, and the reasons; ``source`` names the evidence."""
    if judged is None:
        return "lost", [EMPTY.format(source=source)]
    quality = judged.quality
    if quality.iou < _LEAST_OVERLAP:
        return "lost", [f"lost: the mask does not support the pose (IoU {quality.iou:.2f})"]
    reasons = list(judged.reasons)
    largest_px = max(_LARGEST_PX, _CONTOUR_FACTOR * session.contour_px_95)
    if quality.iou < session.iou - OVERLAP_LOSS or quality.contour_px_95 > largest_px:
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


def describe(
    time: float,
    status: TrackStatus,
    reasons: tuple[str, ...],
    at: Posed,
    covariance: Float64,
    base: Float64,
    offsets: Mapping[str, float],
    instrument: Instrument,
    camera: Camera,
    *,
    seconds: float,
    judged: JudgedFrame | None,
) -> TrackResult:
    """Return a frame's result with the error that is expected of its tips; ``judged`` is how the pose was judged."""
    tips, _ = locate_tips(instrument, camera, at)
    error = expected_error(instrument, at, covariance) if judged is None else judged.error
    residual = None if judged is None else NORMAL_MEDIAN * judged.quality.contour_px_median
    return TrackResult(
        time=time,
        status=status,
        reasons=reasons,
        camera_from_root=at.pose,
        joints=dict(zip(instrument.joint_names, at.joints.tolist(), strict=True)),
        covariance=covariance,
        tips=np.array(tips),
        tip_std_mm=mean_of_tips_mm(instrument, error),
        camera_from_base=base,
        offsets=dict(offsets),
        seconds=seconds,
        residual_px=residual,
    )
