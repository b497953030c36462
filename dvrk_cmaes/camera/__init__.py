"""Camera model (intrinsics and lens distortion), rigs of several cameras, and the readers of calibration files."""

from __future__ import annotations

from dvrk_cmaes.camera.model import Camera
from dvrk_cmaes.camera.rig import Rig, View

__all__ = ["Camera", "Rig", "View"]
