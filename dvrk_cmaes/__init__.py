"""Pose and joint angles of da Vinci Research Kit instruments from one endoscope frame, on a CPU."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dvrk_cmaes._version import __version__

if TYPE_CHECKING:
    from dvrk_cmaes.calibration import SessionCalibration, SessionFrame, calibrate_session
    from dvrk_cmaes.camera import Camera
    from dvrk_cmaes.config import EstimateConfig
    from dvrk_cmaes.estimation import estimate
    from dvrk_cmaes.instrument import Instrument, load_instrument
    from dvrk_cmaes.results.result import Result
    from dvrk_cmaes.results.tracked import TrackResult
    from dvrk_cmaes.silhouette.prepare import prepare
    from dvrk_cmaes.track import Tracker

_HOMES = {
    "Camera": "camera",
    "EstimateConfig": "config",
    "Instrument": "instrument",
    "Result": "results.result",
    "SessionCalibration": "calibration",
    "SessionFrame": "calibration",
    "TrackResult": "results.tracked",
    "Tracker": "track",
    "calibrate_session": "calibration",
    "estimate": "estimation",
    "load_instrument": "instrument",
    "prepare": "silhouette.prepare",
}

__all__ = [
    "Camera",
    "EstimateConfig",
    "Instrument",
    "Result",
    "SessionCalibration",
    "SessionFrame",
    "TrackResult",
    "Tracker",
    "__version__",
    "calibrate_session",
    "estimate",
    "load_instrument",
    "prepare",
]


def __getattr__(name: str) -> Any:
    """Import public names when they are first used: the libraries behind them take a while to load."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
