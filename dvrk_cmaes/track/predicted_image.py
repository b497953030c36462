"""What a calibration expects of an image: pose and joints, and how far they may be off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.sparse import LEAST_ERROR
from dvrk_cmaes.track.calibrated_frames import calibration_covariance
from dvrk_cmaes.track.calibration_lag import predicted_with_lag
from dvrk_cmaes.track.reading_buffer import ReadingAt

Float64 = NDArray[np.float64]

ROLL: Final = 5
"""Index, among the changes of pose and joints, of the first that is an error of the wrist: roll."""
_WRIST_ERROR = 2.0
"""Factor on the errors of roll and joints that a calibration expects of later images.

In 12 recordings with known truth the wrist was 1.5 to 2.5 standard deviations (root mean square) off what the
keyframes before an image expect; the arm was 0.5 to 1.
"""
_UNTOLD_M, _UNTOLD_RAD = 0.01, 0.2  # standard deviations of the arm's motion where its readings are missing or frozen


@dataclass(frozen=True, eq=False)
class PredictedImage:
    """What is expected of an image.

    ``at`` is where the calibration expects the instrument. ``prior`` (D, D) is the covariance of the image's own
    deviation from there, of which ``by_lag`` (D, D) is the lag's part; ``shared`` (D, D) is that by the calibration's
    errors, and ``jacobian`` (D, K) the change of ``at`` with the calibration. ``base_from_root`` (4, 4), m, and
    ``roll_offset``, rad, are those of the calibration at the readings.
    """

    at: Posed
    prior: Float64
    by_lag: Float64
    shared: Float64
    jacobian: Float64
    base_from_root: Float64
    roll_offset: float

    @classmethod
    def of(
        cls,
        calibration: SessionCalibration,
        outer: Float64,
        reading: ReadingAt,
        lag_std: float,
        instrument: Instrument,
        *,
        told: bool = True,
    ) -> PredictedImage:
        """Predict an image.

        ``outer`` (4,), rad and m, are the outer joints at the time of the image less the lag, whose standard deviation
        is ``lag_std``, s; ``told`` tells whether they were read then, by ``reading``.
        """
        names = instrument.joint_names
        model, own = calibration.model(outer[None], reading.joints[None], names)
        prior = model.covariance(own)[0]
        by_lag = np.zeros_like(prior)
        if not told:
            prior = prior + np.diag([_UNTOLD_M**2] * 3 + [_UNTOLD_RAD**2] * (3 + len(names)))
        if lag_std > 0:
            rates = np.concatenate([reading.outer_rate, reading.joint_rate])
            late = lag_std * predicted_with_lag(calibration, outer, reading.joints, rates, instrument)[1]
            by_lag = np.outer(late, late)
        if reading.sparse is not None:
            for joint, error in enumerate(reading.sparse.error.tolist()):
                if error > LEAST_ERROR:
                    alone = np.eye(len(outer) + len(names))[joint]
                    off = error * predicted_with_lag(calibration, outer, reading.joints, alone, instrument)[1]
                    prior = prior + np.outer(off, off)
        factor = np.ones(len(prior))
        factor[ROLL:] = _WRIST_ERROR
        widened = np.outer(factor, factor)
        jacobian = model.jacobian(own)[0]
        shared = jacobian @ calibration_covariance(calibration) @ jacobian.T
        return cls(
            model.predict(own)[0],
            (prior + by_lag) * widened,
            by_lag * widened,
            shared * widened,
            jacobian,
            model.base_from_root(own.offsets)[0],
            float(own.offsets[1] + model.correction.values[0, 0]),
        )
