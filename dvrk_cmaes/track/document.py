"""The base, the offsets and the lag that were found while following, as a session's calibration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import BASE_AXES, OUTER_OFFSETS, Deviations
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.joints.lag import Lag, Unit
from dvrk_cmaes.track.lag import FoundLag
from dvrk_cmaes.track.state import FilterState


def calibration_of(
    state: FilterState,
    lag: FoundLag | None,
    instrument: Instrument,
    arm: Arm,
    config: EstimateConfig,
    *,
    interval: float,
    unit: Unit,
) -> SessionCalibration:
    """Return the calibration that a state amounts to; ``interval`` s is the time between images.

    The offset of insertion is taken for zero, with its standard deviation beforehand.
    """
    names = (*OUTER_OFFSETS, *instrument.joint_names)
    known = [*range(6), *range(7, 8 + len(instrument.joint_names))]
    covariance: NDArray[np.float64] = np.zeros((6 + len(names), 6 + len(names)))
    count = len(known)
    covariance[np.ix_(known, known)] = state.covariance[:count, :count]
    covariance[6, 6] = (config.session.insertion_offset_mm * 1e-3) ** 2
    spread = Deviations.of(config.session, instrument.joint_names)
    outer = dict(zip(("yaw", "pitch", "insertion", "roll"), spread.outer.tolist(), strict=True))
    joints = dict(zip(instrument.joint_names, spread.joints.tolist(), strict=True))
    slack = {"slack_translation": float(spread.slack[0]), "slack_rotation": float(spread.slack[3])}
    applied = None
    if lag is not None:
        factor = 1.0 if unit == "s" else 1.0 / interval
        step = interval if unit == "s" else 1.0
        applied = Lag.of(lag.seconds * factor, lag.std * factor, unit, step, applied=True)
    return SessionCalibration(
        instrument=instrument.name,
        camera_from_base=state.camera_from_base,
        offsets=dict(zip(names, [0.0, *state.offsets.tolist()], strict=True)),
        axes=(*BASE_AXES, *names),
        covariance=covariance,
        covariance_given_camera=covariance,
        spreads={**outer, **joints, **slack},
        lag=applied,
        arm=arm,
        roll_offset=instrument.roll_offset,
        seed=config.seed,
        config=config.as_dict(),
    )
