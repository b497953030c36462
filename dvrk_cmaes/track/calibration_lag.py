"""The lag of a calibration, and how far it may be off."""

from __future__ import annotations

from dataclasses import dataclass

from dvrk_cmaes.calibration.document import SessionCalibration


@dataclass(frozen=True)
class FoundLag:
    """A lag and its standard deviation, s."""

    seconds: float
    std: float


def lag_of(calibration: SessionCalibration, unknown: float) -> FoundLag | None:
    """Return the lag that is taken out of the readings, and its standard deviation; None if nothing tells one.

    Where it is not determined, none is taken out, and the curve of disagreement tells how large it may be;
    ``unknown`` is the standard deviation, s, beforehand. Where the curve is flat, as with few keyframes, the standard
    deviation is larger than that of the least disagreement: errors that keyframes share displace that, or make a lag
    where none is told.
    """
    found, curve = calibration.lag, calibration.lag_curve
    curve = curve if curve is not None and curve.unit == "s" and len(curve.lags) > 1 else None
    if found is None or found.seconds is None:
        return None if curve is None else FoundLag(0.0, curve.root_mean_square(len(calibration.frames), unknown))
    interval = found.seconds / found.frames if found.frames else 0.0
    std = found.std_seconds if found.std_seconds is not None else (found.std_frames or 0.0) * interval
    value = found.seconds if found.applied else 0.0
    if not found.applied:
        std = max(std, abs(found.seconds))
    if curve is not None:
        std = max(std, curve.least_std(len(calibration.frames), unknown, value, applied=found.applied))
    return FoundLag(value, std)


def lag_and_std(calibration: SessionCalibration, unknown: float) -> tuple[float, float]:
    """Return the lag that is taken out of the readings and its standard deviation, s, as in `lag_of`.

    They are 0 and ``unknown`` where nothing tells one.
    """
    found = lag_of(calibration, unknown)
    return (0.0, unknown) if found is None else (found.seconds, found.std)
