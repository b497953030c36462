"""The window: images whose deviations from a calibration's predictions are estimated together, and their results.

A recording on disk is one window of all its frames; while images come, the window is the last fifteen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.lasting_errors import CORRELATED_FRAMES
from dvrk_cmaes.calibration.mask_growth import covariance_of_masks
from dvrk_cmaes.calibration.prediction import Prediction, calibration_covariance
from dvrk_cmaes.calibration.session_camera import covariance_of_camera
from dvrk_cmaes.calibration.session_doubts import resting_on
from dvrk_cmaes.calibration.solve import robust_weights
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Float64, Posed, inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.doubts import pose_lost, reasons
from dvrk_cmaes.pose.expected_error import expected_error, locate_tips
from dvrk_cmaes.pose.judge import doubts_of_agreement
from dvrk_cmaes.pose.terms.shared_errors import MEAN_ERRORS
from dvrk_cmaes.pose.tip_probability import tip_probability
from dvrk_cmaes.results.result import ExpectedError
from dvrk_cmaes.results.tracked import TrackResult, TrackStatus
from dvrk_cmaes.track.colour_edges import EdgeFit
from dvrk_cmaes.track.deviations import smoothed_deviations
from dvrk_cmaes.track.recorded_frames import JudgedFrame


@dataclass(frozen=True, eq=False)
class FitEvidence:
    """What a fit tells of an image's deviation from its prediction.

    ``information`` (D, D), ``optimum`` (D,) and ``by_masks`` (D, 7) are those of `FrameDeviations.of`, zero where it
    tells nothing; ``misfit`` is the squared misfit per parameter.
    """

    information: Float64
    optimum: Float64
    by_masks: Float64
    misfit: float

    @classmethod
    def of(
        cls, fit: FrameFit | EdgeFit | None, predicted: Posed, spread: Float64, *, inflation: float = 1.0, holds: bool
    ) -> FitEvidence:
        """Weigh a fit by how it agrees with the prediction, whose covariance is ``spread`` (D, D).

        ``inflation`` is the factor by which the contour's roughness widens the covariance of the fit; one that does not
        hold tells nothing.
        """
        size = len(spread)
        nothing = np.zeros((size, MEAN_ERRORS))
        if fit is None:
            return cls(np.zeros((size, size)), np.zeros(size), nothing, 0.0)
        deviation = fit.at.minus(predicted)
        own = np.linalg.pinv(fit.information, rcond=1e-9, hermitian=True)
        least = deviation - own @ fit.slope
        misfit = float(least @ np.linalg.solve(spread + own, least)) / size
        weight = float(robust_weights(np.array([misfit * size]), size)[0]) if holds else 0.0
        weight /= inflation * CORRELATED_FRAMES
        optimum = weight * (fit.information @ deviation - fit.slope)
        by_masks = nothing if fit.by_masks is None else weight * fit.by_masks
        return cls(weight * fit.information, optimum, by_masks, misfit)


@dataclass(frozen=True, eq=False)
class WindowImage:
    """An image of the window: its time, s, what is expected of it, as in `Prediction`, and what its fit tells."""

    time: float
    at: Posed
    prior: Float64
    jacobian: Float64
    told: FitEvidence


def solve_window(
    images: Sequence[WindowImage], calibration: SessionCalibration, camera: Camera, *, only_last: bool = False
) -> list[tuple[Posed, Float64]]:
    """Find the poses and joints of N images by what all of them tell, with their covariances (D, D).

    The covariances include those of the calibration. With ``only_last``, the list has the last image alone.
    """
    corrected = calibration.corrected(camera)
    deviations, covariances, responses = smoothed_deviations(
        np.array([image.time for image in images]),
        np.array([image.prior for image in images]),
        np.array([image.told.information for image in images]),
        np.array([image.told.optimum for image in images]),
        np.array([image.jacobian for image in images]),
        np.array([image.told.by_masks for image in images]),
        only_last=only_last,
    )
    calibrated, found = calibration_covariance(calibration), []
    solved = images[-len(deviations) :]
    for image, deviation, own, response in zip(solved, deviations, covariances, responses, strict=True):
        at, (by_calibration, by_masks) = image.at.moved(deviation), np.split(response, [len(calibrated)], axis=1)
        covariance = own + by_calibration @ calibrated @ by_calibration.T
        covariance += covariance_of_masks(calibration.masks, by_masks, by_calibration)
        found.append((at, covariance + covariance_of_camera(calibration.camera, at, corrected)))
    return found


def mean_of_tips_mm(instrument: Instrument, error: ExpectedError) -> float | None:
    """Return the mean of the tips' expected errors, mm; None for an instrument without tips."""
    each = [value for name, value in error.tip_mm.items() if name != "mean"]
    return float(np.mean(each)) if instrument.jaw_tips else None


def status_of(
    judged: JudgedFrame | None,
    misfit: float,
    calibration: SessionCalibration,
    config: EstimateConfig,
    pixel_scale: float,
    source: str = "mask",
) -> tuple[TrackStatus, list[str]]:
    """Return the status of an image by its mask alone, and the reasons; ``source`` names the evidence.

    ``pixel_scale`` is that of the camera.
    """
    no_support = pose_lost(source, None if judged is None else judged.quality.iou)
    if judged is None or no_support is not None:
        return "lost", reasons(no_support)
    usual = calibration.iou, calibration.contour_px_95
    agreement = doubts_of_agreement("followed", misfit, config.session, judged.quality, usual, pixel_scale)
    found = [*judged.reasons, *agreement]
    return "doubtful" if found else "ok", found


def result_of(
    time: float,
    status: TrackStatus,
    reasons: Sequence[str],
    found: tuple[Posed, Float64],
    error: ExpectedError | None,
    predicted: Prediction,
    number: int,
    calibration: SessionCalibration,
    instrument: Instrument,
    camera: Camera,
    within_mm: float,
    *,
    seconds: float = 0.0,
    residual_px: float | None = None,
    remarks: tuple[str, ...] = (),
) -> TrackResult:
    """Describe an image of the window; one for whose pose there is any reason to doubt it is not ok.

    Parameters
    ----------
    time, status, reasons, seconds, residual_px, remarks
        As in `TrackResult`; the reasons are those of the status and any others.
    found
        Pose and joints, and their covariance (D, D).
    error
        The error that is expected of the pose, if that is known already.
    predicted, number
        What was expected of some images, and the number of this one among them.
    calibration
        The calibration on which the result rests.
    instrument, camera
        The instrument, and the camera as its file has it.
    within_mm
        Distance of the tips from the truth whose probability is stated.
    """
    at, covariance = found
    tips, _ = locate_tips(instrument, camera, at)
    error = expected_error(instrument, at, covariance) if error is None else error
    result = TrackResult(
        time=time,
        status="doubtful" if reasons and status == "ok" else status,
        reasons=tuple(reasons),
        camera_from_root=at.pose,
        joints=dict(zip(instrument.joint_names, at.joints.tolist(), strict=True)),
        covariance=covariance,
        tips=np.array(tips),
        tip_std_mm=mean_of_tips_mm(instrument, error),
        camera_from_base=np.asarray(at.pose @ inverse(predicted.base_from_root[number])),
        offsets=predicted.offsets(number, at, instrument.joint_names),
        seconds=seconds,
        residual_px=residual_px,
        tip_probability=None if status == "lost" else tip_probability(error.of_tips_mm, within_mm),
        remarks=remarks,
    )
    return resting_on(result, calibration)
