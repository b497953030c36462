"""Images followed without a calibration, beside keyframes that tell the base but not the lag."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.expected_error import expected_error
from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.track.calibrated_frames import covariance_of_margin
from dvrk_cmaes.track.predicted_image import PredictedImage
from dvrk_cmaes.track.reading_buffer import ReadingAt

_KNOWN: Final = 2.5  # of the error of the tips that is ok: largest of those that are expected but for the lag
_AGREES: Final = 4.0  # largest squared misfit per parameter


def confirmed_by(
    calibration: SessionCalibration,
    result: TrackResult,
    reading: ReadingAt,
    lag_std: float,
    rig: Rig,
    config: EstimateConfig,
    instrument: Instrument,
) -> TrackResult | None:
    """Return the result of an image with the error that is expected of it, if a calibration expects it there.

    ``reading`` is that of the time of the image less the calibration's lag, whose standard deviation is ``lag_std``, s.
    To the error of the result that by the margin of the masks is added, as far as the keyframes tell that. None if the
    calibration expects the instrument elsewhere, or too little is known to say.
    """
    if result.camera_from_root is None or result.covariance is None or not reading.has_outer or reading.still:
        return None
    at = Posed(result.camera_from_root, np.array([result.joints[name] for name in instrument.joint_names]))
    known = PredictedImage.of(calibration, reading.outer, reading, 0.0, instrument)
    limit = config.trust.tip_mm
    if expected_error(instrument, known.at, known.prior + known.shared).of_tips_mm > _KNOWN * limit:
        return None
    expected = PredictedImage.of(calibration, reading.outer, reading, lag_std, instrument)
    apart = at.minus(expected.at)
    spread = expected.prior + expected.shared + result.covariance
    if float(apart @ np.linalg.solve(spread, apart)) > _AGREES * len(apart):
        return None
    camera = calibration.corrected(rig.views[0].camera)
    covariance = result.covariance + covariance_of_margin(at, calibration.masks, camera, instrument)
    error = expected_error(instrument, at, covariance)
    each = [value for name, value in error.tip_mm.items() if name != "mean"]
    tip_std = float(np.mean(each)) if instrument.jaw_tips else None
    found = replace(result, covariance=covariance, tip_std_mm=tip_std)
    if error.of_tips_mm <= limit:
        return found
    reason = f"tips not accurate: their expected error is {error.of_tips_mm:.1f} mm, more than {limit:g} mm"
    return replace(found, status="doubtful", reasons=(reason,))
