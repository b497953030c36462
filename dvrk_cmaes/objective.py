"""The full loss of candidate poses against the evidence, at one image size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.distance_field import distance_field
from dvrk_cmaes.evidence import Evidence, shrunk
from dvrk_cmaes.losses import (
    LossWeights,
    Terms,
    cylinder_loss,
    keypoint_loss,
    mse_loss,
    project_cylinder,
    reading_loss,
    scale_loss,
)
from dvrk_cmaes.silhouette import PixelSums, Renderer

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Readings:
    """Joint readings as evidence: values (J,), NaN where unknown, and their standard deviations (J,), rad."""

    values: Float64
    spread: Float64


class Objective:
    """Weighted sum of all losses of a population of candidates.

    The mask is averaged down to the renderer's image size; ``decay`` (px of the full image) is the length over which
    the distance field grows by one.
    """

    def __init__(
        self,
        renderer: Renderer,
        evidence: Evidence,
        readings: Readings,
        weights: LossWeights,
        *,
        decay: float = 30.0,
        field: str = "fmm",
        lines_per_pixel: int = 1,
    ) -> None:
        self.renderer = renderer
        self.evidence = evidence
        self.readings = readings
        self.weights = weights
        self.lines_per_pixel = lines_per_pixel
        self.evaluations = 0
        camera = renderer.camera
        camera = renderer.camera
        size = (camera.width, camera.height)
        mask = evidence.mask.astype(np.float32)
        weight = evidence.weight
        if mask.shape != (camera.height, camera.width):
            full_weight = weight
            weight = shrunk(full_weight, *size)
            mask = np.asarray(shrunk(mask * full_weight, *size) / np.maximum(weight, 1e-6), dtype=np.float32)
        scale = camera.width / evidence.mask.shape[1]
        far = distance_field(mask > 0.5, field) / (decay * scale)
        self._area = float((mask * weight).sum())
        self._square = float((mask * mask * weight).sum())
        self._images = PixelSums.of(np.stack([np.ones_like(mask), mask, far.astype(np.float32)]), weight)

    def terms(self, camera_from_root: Float64, joints: Float64) -> Terms:
        """All terms of C candidates: poses (C, 4, 4) and joints (C, J)."""
        self.evaluations += len(camera_from_root)
        sums = self.renderer.sums(camera_from_root, joints, self._images, lines_per_pixel=self.lines_per_pixel)
        area, overlap, far = sums.T
        none = np.zeros(len(camera_from_root))
        instrument = self.renderer.body.instrument
        cylinder = keypoints = none
        edges, shaft = self.evidence.shaft_edges, instrument.shaft
        full = self.evidence.camera
        if edges and shaft is not None:
            rotation = camera_from_root[:, :3, :3]
            direction = rotation @ shaft.direction
            point = rotation @ shaft.point + camera_from_root[:, :3, 3]
            projected = project_cylinder(point, direction, shaft.radius)
            # The likeliest pair is not always the shaft: a candidate may fit any of them.
            pairs = [cylinder_loss(projected, pair.planes, full, self.weights.line_offset) for pair in edges]
            cylinder = np.min(pairs, axis=0)
        tips = self.evidence.tips
        if tips is not None and instrument.jaw_tips:
            points = instrument.tips(joints) @ np.swapaxes(camera_from_root[:, :3, :3], 1, 2)
            points = points + camera_from_root[:, None, :3, 3]
            points[..., 2] = np.maximum(points[..., 2], 1e-3)
            keypoints = keypoint_loss(full.project(points), tips)
        return Terms(
            mse=mse_loss(area, overlap, self._square) / self._area,
            dist=far / self._area,
            scale=scale_loss(area, self._area) / self._area,
            cylinder=cylinder,
            keypoints=keypoints,
            readings=reading_loss(joints, self.readings.values, self.readings.spread),
        )

    def __call__(self, camera_from_root: Float64, joints: Float64) -> Float64:
        """Total loss of C candidates, (C,)."""
        return self.terms(camera_from_root, joints).total(self.weights)
