"""Plot of a session's disagreement as a function of the lag between images and readings.

As in panels.py, coordinates in the drawing are computed here; the template makes the SVG.
"""

from __future__ import annotations

from dataclasses import dataclass

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.report.plots.axes import Axis, value_axis

_LEFT, _RIGHT, _TOP, _BOTTOM = 62.0, 546.0, 8.0, 204.0
_UNIT = {"s": "lag of the images, s", "frames": "lag of the images, frames"}


@dataclass(frozen=True)
class LagPlot:
    """The curve as points, and the coordinates of the lag found and of one standard deviation beside it, or None."""

    across: Axis
    up: Axis
    points: tuple[tuple[float, float], ...]
    found: float | None
    std: tuple[float, float] | None


def lag_plot(calibration: SessionCalibration) -> LagPlot | None:
    """Plot the disagreement of a calibration's frames; None if no lag was searched."""
    curve, lag = calibration.lag_curve, calibration.lag
    if curve is None or len(curve.lags) < 2:
        return None
    low, high = min(0.0, float(curve.lags.min())), max(0.0, float(curve.lags.max()))
    across = value_axis(_UNIT[curve.unit], low, high, start=_LEFT, end=_RIGHT, to_ticks=False)
    up = value_axis("disagreement", 0.0, max(float(curve.misfit.max()), 1.0), start=_BOTTOM, end=_TOP, most=5)
    points = tuple((across.at(float(x)), up.at(float(y))) for x, y in zip(curve.lags, curve.misfit, strict=True))
    found, std = None, None
    if lag is not None:
        value, by = (lag.seconds, lag.std_seconds) if curve.unit == "s" else (lag.frames, lag.std_frames)
        if value is not None:
            found = across.clamped(value)
            std = None if by is None else (across.clamped(value - by), across.clamped(value + by))
    return LagPlot(across, up, points, found, std)
