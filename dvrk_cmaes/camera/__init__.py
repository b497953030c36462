"""Camera model (intrinsics and lens distortion) and the readers of camera calibration files."""

from __future__ import annotations

from dvrk_cmaes.camera.model import Camera

__all__ = ["Camera"]
