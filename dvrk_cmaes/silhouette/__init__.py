"""Silhouettes by outline and ray: poses in, spans out; from spans, sums, masks and coverage."""

from __future__ import annotations

from dvrk_cmaes.silhouette.outline import OutlinePoints
from dvrk_cmaes.silhouette.pose_batches import LANES
from dvrk_cmaes.silhouette.renderer import NEAR, Body, PixelSums, Renderer

__all__ = ["LANES", "NEAR", "Body", "OutlinePoints", "PixelSums", "Renderer"]
