"""Pose and joint angles of da Vinci Research Kit instruments from endoscope frames, on a CPU.

`estimate` gives the `Result` of a frame from arrays: a mask, a `Camera` (`read_camera`), readings, an instrument that
`prepare` prepares once. `calibrate_session` finds the arm's base in the camera and the readings' offsets from several
frames. `Tracker` follows an instrument from image to image. `read_session` reads a folder of frames, `read_results`
what the commands wrote. The same from a shell: `dvrk-cmaes help`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
    from dvrk_cmaes.calibration.document import SessionCalibration, read_calibration
    from dvrk_cmaes.calibration.session_frame import SessionFrame
    from dvrk_cmaes.camera import Camera, Rig
    from dvrk_cmaes.camera.files import read_camera
    from dvrk_cmaes.config import EstimateConfig, __version__
    from dvrk_cmaes.errors import DvrkCmaesError, InputError
    from dvrk_cmaes.estimation import ToolInFrame, estimate, estimate_tools
    from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
    from dvrk_cmaes.frames.session_folder import Session, read_session
    from dvrk_cmaes.instrument import Instrument, load_instrument
    from dvrk_cmaes.joints.lag import Lag
    from dvrk_cmaes.joints.series import ReadingSeries
    from dvrk_cmaes.results.folder import ResultsFolder, read_result, read_results
    from dvrk_cmaes.results.result import Result
    from dvrk_cmaes.results.tracked import TrackResult
    from dvrk_cmaes.silhouette import Body, Renderer
    from dvrk_cmaes.silhouette.prepare import prepare
    from dvrk_cmaes.track import Tracker
    from dvrk_cmaes.track.keyframe_problem import Keyframe, KeyframeProblem, Solution

_HOMES = {
    "Body": "silhouette",
    "Camera": "camera",
    "DvrkCmaesError": "errors",
    "EstimateConfig": "config",
    "FrameData": "frames.frame",
    "FrameFiles": "frames.frame",
    "InputError": "errors",
    "Instrument": "instrument",
    "Keyframe": "track.keyframe_problem",
    "KeyframeProblem": "track.keyframe_problem",
    "Lag": "joints.lag",
    "ReadingSeries": "joints.series",
    "Renderer": "silhouette",
    "Result": "results.result",
    "ResultsFolder": "results.folder",
    "Rig": "camera",
    "Session": "frames.session_folder",
    "SessionCalibration": "calibration.document",
    "SessionFrame": "calibration.session_frame",
    "SolvedSession": "calibration.calibrate",
    "Solution": "track.keyframe_problem",
    "ToolInFrame": "estimation",
    "TrackResult": "results.tracked",
    "Tracker": "track",
    "__version__": "config",
    "calibrate_session": "calibration.calibrate",
    "estimate": "estimation",
    "estimate_tools": "estimation",
    "load_instrument": "instrument",
    "prepare": "silhouette.prepare",
    "read_calibration": "calibration.document",
    "read_camera": "camera.files",
    "read_frame": "frames.frame",
    "read_result": "results.folder",
    "read_results": "results.folder",
    "read_session": "frames.session_folder",
}
"""Module of each public name."""

__all__ = [
    "Body",
    "Camera",
    "DvrkCmaesError",
    "EstimateConfig",
    "FrameData",
    "FrameFiles",
    "InputError",
    "Instrument",
    "Keyframe",
    "KeyframeProblem",
    "Lag",
    "ReadingSeries",
    "Renderer",
    "Result",
    "ResultsFolder",
    "Rig",
    "Session",
    "SessionCalibration",
    "SessionFrame",
    "Solution",
    "SolvedSession",
    "ToolInFrame",
    "TrackResult",
    "Tracker",
    "__version__",
    "calibrate_session",
    "estimate",
    "estimate_tools",
    "load_instrument",
    "prepare",
    "read_calibration",
    "read_camera",
    "read_frame",
    "read_result",
    "read_results",
    "read_session",
]


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)


def __getattr__(name: str) -> Any:
    """Import public names when they are first used: the libraries behind them take a while to load."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
