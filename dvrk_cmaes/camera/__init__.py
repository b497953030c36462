"""Cameras: intrinsics and lens distortion, and the readers of the calibration files that labs have."""

from __future__ import annotations

from dvrk_cmaes.camera.model import Camera

__all__ = ["Camera"]
