"""Images followed without a calibration, beside keyframes that tell the base but not the lag."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.consensus import INLIER_MISFIT
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.mask_growth import changes_by_masks, covariance_of_masks
from dvrk_cmaes.calibration.prediction import WRIST_ERROR, Prediction, endoscope_at
from dvrk_cmaes.pose.doubts import tips_not_accurate
from dvrk_cmaes.pose.expected_error import expected_error
from dvrk_cmaes.pose.tip_probability import tip_probability
from dvrk_cmaes.results.parts import posed
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.track.followed import Followed
from dvrk_cmaes.track.reading_buffer import ReadingAt
from dvrk_cmaes.track.window import mean_of_tips_mm

_KNOWN: Final = 2.5  # of the error of the tips that is ok: largest of those that are expected but for the lag


def confirmed_by(
    calibration: SessionCalibration,
    result: TrackResult,
    reading: ReadingAt,
    lag_std: float,
    given: Followed,
) -> TrackResult | None:
    """Return the result of an image with the error that is expected of it, if a calibration expects it there.

    ``reading`` is that of the time of the image less the calibration's lag, whose standard deviation is ``lag_std``, s.
    The error by the margin of the masks is added, as far as the keyframes tell it. None if the calibration expects the
    instrument elsewhere, or too little is known to say.
    """
    instrument, trust = given.instrument, given.config.trust
    if result.camera_from_root is None or result.covariance is None or not reading.has_outer or reading.still:
        return None
    at = posed(result, instrument.joint_names)
    readings, names = (reading.outer[None], reading.joints[None]), instrument.joint_names
    endoscope = endoscope_at(calibration, result.time, reading.ecm)
    expected = Prediction.of(calibration, *readings, names, wrist=WRIST_ERROR, endoscope=endoscope)
    if expected_error(instrument, expected.at[0], expected.spread[0]).of_tips_mm > _KNOWN * trust.tip_mm:
        return None
    moved = lag_std * reading.rates[None]
    late = Prediction.of(calibration, *readings, names, late=moved, wrist=WRIST_ERROR, endoscope=endoscope)
    apart = at.minus(expected.at[0])
    spread = late.spread[0] + result.covariance
    if float(apart @ np.linalg.solve(spread, apart)) > INLIER_MISFIT * len(apart):
        return None
    camera = calibration.corrected(given.rig.views[0].camera)
    covariance = result.covariance + covariance_of_masks(calibration.masks, changes_by_masks(at, camera, instrument))
    error = expected_error(instrument, at, covariance)
    probability = tip_probability(error.of_tips_mm, trust.tip_mm)
    reason = tips_not_accurate(error, trust)
    return replace(
        result,
        status="ok" if reason is None else "doubtful",
        reasons=() if reason is None else (reason,),
        covariance=covariance,
        tip_std_mm=mean_of_tips_mm(instrument, error),
        tip_probability=probability,
    )
