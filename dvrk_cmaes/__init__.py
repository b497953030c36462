"""Pose and joint angles of da Vinci Research Kit instruments from one endoscope frame, on a CPU."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
    from dvrk_cmaes.calibration.document import SessionCalibration, read_calibration
    from dvrk_cmaes.calibration.frame_task import LeaveOneOutPrediction, SessionFrame
    from dvrk_cmaes.calibration.instrument_test import CandidateFit
    from dvrk_cmaes.calibration.lag import LagCurve
    from dvrk_cmaes.calibration.masks_again import MasksAgain, PackedMask
    from dvrk_cmaes.calibration.session_cables import SessionCables
    from dvrk_cmaes.calibration.session_camera import SessionCamera
    from dvrk_cmaes.calibration.session_masks import SessionMasks
    from dvrk_cmaes.calibration.session_rig import ViewRotation, ViewScale
    from dvrk_cmaes.camera import Camera, Rig
    from dvrk_cmaes.camera.files import read_camera
    from dvrk_cmaes.camera.view_document import ViewDocument
    from dvrk_cmaes.config import (
        EstimateConfig,
        LookAtRange,
        LossWeights,
        OutlineConfig,
        ReadingSigmas,
        RefineConfig,
        SearchConfig,
        SessionConfig,
        SilhouetteConfig,
        TrackConfig,
        TrustConfig,
        __version__,
    )
    from dvrk_cmaes.errors import DvrkCmaesError, InputError
    from dvrk_cmaes.estimation import ToolInFrame, estimate, estimate_tools
    from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
    from dvrk_cmaes.frames.session_folder import Session, read_session
    from dvrk_cmaes.frames.session_video import SessionVideo
    from dvrk_cmaes.instrument import Instrument, load_instrument
    from dvrk_cmaes.instrument.model import JawTip, Link, Shaft
    from dvrk_cmaes.joints.lag import Lag
    from dvrk_cmaes.joints.series import ReadingSeries
    from dvrk_cmaes.results.file import read_result
    from dvrk_cmaes.results.folder import ResultsFolder, read_results
    from dvrk_cmaes.results.links import LinkModel
    from dvrk_cmaes.results.result import Alternative, ExpectedError, Quality, Result, ViewCheck
    from dvrk_cmaes.results.tracked import BaseKnown, TrackResult
    from dvrk_cmaes.segment.segmentation import Hints
    from dvrk_cmaes.silhouette import Body, Renderer
    from dvrk_cmaes.silhouette.prepare import prepare
    from dvrk_cmaes.track import Tracker
    from dvrk_cmaes.track.calibration_lag import FoundLag
    from dvrk_cmaes.track.keyframe_problem import Keyframe, KeyframeProblem, KeyframeTask, Solution

_HOMES = {
    "Alternative": "results.result",
    "BaseKnown": "results.tracked",
    "Body": "silhouette",
    "Camera": "camera",
    "DvrkCmaesError": "errors",
    "EstimateConfig": "config",
    "ExpectedError": "results.result",
    "FoundLag": "track.calibration_lag",
    "FrameData": "frames.frame",
    "FrameFiles": "frames.frame",
    "Hints": "segment.segmentation",
    "InputError": "errors",
    "Instrument": "instrument",
    "JawTip": "instrument.model",
    "Keyframe": "track.keyframe_problem",
    "KeyframeProblem": "track.keyframe_problem",
    "KeyframeTask": "track.keyframe_problem",
    "Lag": "joints.lag",
    "LagCurve": "calibration.lag",
    "LeaveOneOutPrediction": "calibration.frame_task",
    "Link": "instrument.model",
    "LinkModel": "results.links",
    "LookAtRange": "config",
    "LossWeights": "config",
    "MasksAgain": "calibration.masks_again",
    "OutlineConfig": "config",
    "PackedMask": "calibration.masks_again",
    "Quality": "results.result",
    "ReadingSeries": "joints.series",
    "ReadingSigmas": "config",
    "RefineConfig": "config",
    "Renderer": "silhouette",
    "Result": "results.result",
    "ResultsFolder": "results.folder",
    "Rig": "camera",
    "SearchConfig": "config",
    "Session": "frames.session_folder",
    "SessionCables": "calibration.session_cables",
    "SessionCalibration": "calibration.document",
    "CandidateFit": "calibration.instrument_test",
    "SessionCamera": "calibration.session_camera",
    "SessionConfig": "config",
    "SessionFrame": "calibration.frame_task",
    "SessionMasks": "calibration.session_masks",
    "SessionVideo": "frames.session_video",
    "Shaft": "instrument.model",
    "SilhouetteConfig": "config",
    "SolvedSession": "calibration.calibrate",
    "Solution": "track.keyframe_problem",
    "ToolInFrame": "estimation",
    "TrackConfig": "config",
    "TrackResult": "results.tracked",
    "Tracker": "track",
    "TrustConfig": "config",
    "ViewCheck": "results.result",
    "ViewDocument": "camera.view_document",
    "ViewRotation": "calibration.session_rig",
    "ViewScale": "calibration.session_rig",
    "__version__": "config",
    "calibrate_session": "calibration.calibrate",
    "estimate": "estimation",
    "estimate_tools": "estimation",
    "load_instrument": "instrument",
    "prepare": "silhouette.prepare",
    "read_calibration": "calibration.document",
    "read_camera": "camera.files",
    "read_frame": "frames.frame",
    "read_result": "results.file",
    "read_results": "results.folder",
    "read_session": "frames.session_folder",
}
"""Module of each public name; a class in the signature of a public function or class is public."""

__all__ = [
    "Alternative",
    "BaseKnown",
    "Body",
    "Camera",
    "CandidateFit",
    "DvrkCmaesError",
    "EstimateConfig",
    "ExpectedError",
    "FoundLag",
    "FrameData",
    "FrameFiles",
    "Hints",
    "InputError",
    "Instrument",
    "JawTip",
    "Keyframe",
    "KeyframeProblem",
    "KeyframeTask",
    "Lag",
    "LagCurve",
    "LeaveOneOutPrediction",
    "Link",
    "LinkModel",
    "LookAtRange",
    "LossWeights",
    "MasksAgain",
    "OutlineConfig",
    "PackedMask",
    "Quality",
    "ReadingSeries",
    "ReadingSigmas",
    "RefineConfig",
    "Renderer",
    "Result",
    "ResultsFolder",
    "Rig",
    "SearchConfig",
    "Session",
    "SessionCables",
    "SessionCalibration",
    "SessionCamera",
    "SessionConfig",
    "SessionFrame",
    "SessionMasks",
    "SessionVideo",
    "Shaft",
    "SilhouetteConfig",
    "Solution",
    "SolvedSession",
    "ToolInFrame",
    "TrackConfig",
    "TrackResult",
    "Tracker",
    "TrustConfig",
    "ViewCheck",
    "ViewDocument",
    "ViewRotation",
    "ViewScale",
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
