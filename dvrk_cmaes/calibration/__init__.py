"""Calibration of a session: one camera_from_base and the joints' offsets, estimated from all its frames."""

from __future__ import annotations

from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session, calibrate_with_evidence, find_lag
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_task import SessionFrame

__all__ = [
    "SessionCalibration",
    "SessionFrame",
    "SolvedSession",
    "calibrate_session",
    "calibrate_with_evidence",
    "find_lag",
]
