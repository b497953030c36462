"""Pose and joint angles of da Vinci Research Kit instruments from one endoscope frame, on a CPU."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from dvrk_cmaes.camera import Camera
    from dvrk_cmaes.config import EstimateConfig
    from dvrk_cmaes.estimation import estimate
    from dvrk_cmaes.instrument import Instrument, load_instrument
    from dvrk_cmaes.prepared import prepare
    from dvrk_cmaes.result import Result
    from dvrk_cmaes.session import SessionCalibration, SessionFrame, calibrate_session

_HOMES = {
    "Camera": "camera",
    "EstimateConfig": "config",
    "Instrument": "instrument",
    "Result": "result",
    "SessionCalibration": "session",
    "SessionFrame": "session",
    "calibrate_session": "session",
    "estimate": "estimation",
    "load_instrument": "instrument",
    "prepare": "prepared",
}

__all__ = [
    "Camera",
    "EstimateConfig",
    "Instrument",
    "Result",
    "SessionCalibration",
    "SessionFrame",
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
