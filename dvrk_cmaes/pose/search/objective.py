"""The loss of candidate poses, given the evidence of a frame, at one image size."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig, LossWeights
from dvrk_cmaes.evidence.distance_field import distance_field
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import Float64, Posed, apply, project_cylinder
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search.losses import Terms, cylinder_loss, keypoint_loss
from dvrk_cmaes.silhouette import PixelSums, Renderer


class Objective:
    """Weighted sum of all loss terms, for many candidates at once.

    The mask is downsampled to the renderer's image size, in which instrument and background show.
    """

    def __init__(self, renderer: Renderer, evidence: Evidence, readings: Readings, config: EstimateConfig) -> None:
        self.renderer, self.evidence, self.readings, self.weights = renderer, evidence, readings, config.weights
        camera = renderer.camera
        mask, weight = evidence.at_size(camera.width, camera.height)
        scale = camera.width / evidence.mask.shape[1]
        far = distance_field(mask > 0.5, config.distance_field) / (config.decay_px * scale)
        self._area = float((mask * weight).sum())
        self._square = float((mask * mask * weight).sum())
        self._images = PixelSums.of(np.stack([np.ones_like(mask), mask, far.astype(np.float32)]), weight)

    def terms(self, at: Posed) -> Terms:
        """Compute all terms of C candidates."""
        sums = self.renderer.sums(at.pose, at.joints, self._images)
        of_pose = pose_terms(self.evidence, self.renderer.body.instrument, self.readings, self.weights, at)
        return Terms.of(sums, self._area, self._square, of_pose)

    def cost(self, at: Posed) -> Float64:
        """Compute the total loss of C candidates, (C,)."""
        return self.terms(at).total(self.weights)


def pose_terms(
    evidence: Evidence, instrument: Instrument, readings: Readings, weights: LossWeights, at: Posed
) -> tuple[Float64, Float64, Float64]:
    """Compute the terms of shaft edges, jaw tips and readings, (C,) each, which need no silhouette.

    The terms of shaft edges and jaw tips are zero without evidence.
    """
    cylinder = keypoints = np.zeros(len(at))
    camera, edges, shaft, tips = evidence.camera, evidence.shaft_edges, instrument.shaft, evidence.tips
    rotation, translation = at.pose[:, :3, :3], at.pose[:, :3, 3]
    if edges and shaft is not None:
        projected = project_cylinder(rotation @ shaft.point + translation, rotation @ shaft.direction, shaft.radius)
        # The best supported pair is not always the shaft, so the pair with the smallest loss counts.
        pairs = np.stack([pair.planes for pair in edges])[:, None]
        cylinder = cylinder_loss(projected, pairs, camera, weights.line_offset).min(axis=0)
    if tips is not None and instrument.jaw_tips:
        keypoints = keypoint_loss(project_tips(instrument, camera, at), tips) * (
            1.0 if evidence.tips_given else weights.found_tips
        )
    return cylinder, keypoints, readings.cost(at.joints)


def project_tips(instrument: Instrument, camera: Camera, at: Posed) -> Float64:
    """Project the jaw tips of C candidates, (C, 2, 2) px, with depths limited to at least 1 mm."""
    points = apply(at.pose, instrument.tips(at.joints))
    points[..., 2] = np.maximum(points[..., 2], 1e-3)
    return np.asarray(camera.project(points))
