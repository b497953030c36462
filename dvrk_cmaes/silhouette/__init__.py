"""Render the silhouettes of an instrument: masks, antialiased coverage, outlines, and sums of images over them."""

from __future__ import annotations

from dvrk_cmaes.silhouette.outline import OutlinePoints
from dvrk_cmaes.silhouette.renderer import METHODS, NEAR, Body, PixelSums, Renderer

__all__ = ["METHODS", "NEAR", "Body", "OutlinePoints", "PixelSums", "Renderer"]
