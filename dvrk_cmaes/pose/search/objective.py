"""The loss of candidate poses, given the evidence of a frame, at one image size: the paper's terms, batched.

The silhouette terms are functions of sums of S times fixed images, where the silhouette S is 0 or 1, hence S^2 = S. The
renderer computes these sums without rendering an image. The objective divides the terms by the area of the mask, which
makes them comparable between image sizes. Symbols follow "Differentiable Rendering-based Pose Estimation for Surgical
Robotic Instruments" (Liang et al., 2025).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig, LossWeights
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.outline_noise import distance_field
from dvrk_cmaes.geometry import Float64, Posed, apply, project_cylinder
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
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


@dataclass(frozen=True, eq=False)
class Terms:
    """Loss terms of C candidates, (C,) each; terms without evidence are zero."""

    mse: Float64
    dist: Float64
    scale: Float64
    cylinder: Float64
    keypoints: Float64
    readings: Float64

    def total(self, weights: LossWeights) -> Float64:
        """Return the weighted sum of all terms, (C,)."""
        return np.asarray(sum(getattr(weights, f.name) * getattr(self, f.name) for f in fields(self)))

    @staticmethod
    def of(sums: Float64, mask_area: float, mask_square: float, of_pose: tuple[Float64, Float64, Float64]) -> Terms:
        """Compute L_mse = sum (S - M)^2, L_dist = sum S D and L_scale = abs(sum S - sum M), divided by sum M.

        ``sums`` (C, 3) are sum S, sum S M and sum S D of binary silhouettes S, ``mask_square`` is sum M^2, and
        ``of_pose`` are the terms without a silhouette, as by `objective.pose_terms`.
        """
        area, overlap, far = sums.T
        mse, scale = area - 2 * overlap + mask_square, np.abs(area - mask_area)
        return Terms(mse / mask_area, far / mask_area, scale / mask_area, *of_pose)


def polar_lines(lines: Float64, camera: Camera) -> tuple[Float64, Float64]:
    """Convert homogeneous lines (..., 3) in normalised coordinates to polar form in undistorted pixels.

    The polar form is u cos(theta) + v sin(theta) = rho. Returns theta, rad, and rho, px, (...) each.
    """
    a, b, c = lines[..., 0] / camera.fx, lines[..., 1] / camera.fy, lines[..., 2]
    c = c - a * camera.cx - b * camera.cy
    norm = np.maximum(np.hypot(a, b), 1e-12)
    return np.arctan2(b, a), -c / norm


def line_distance(a: tuple[Float64, Float64], b: tuple[Float64, Float64], offset_weight: float) -> Float64:
    """Compute the distance of lines in polar form: angle, rad, plus ``offset_weight`` (rad/px) times offset, px.

    The sign of the normal is irrelevant: (theta, rho) and (theta + pi, -rho) are the same line.
    """
    theta, rho = _facing(a, b)
    turn = np.mod(a[0] - theta, np.pi)
    return np.asarray(np.minimum(turn, np.pi - turn) + offset_weight * np.abs(a[1] - rho))


def _facing(first: tuple[Float64, Float64], second: tuple[Float64, Float64]) -> tuple[Float64, Float64]:
    """Return the second line in the polar form whose normal is within 90 degrees of that of the first line."""
    turn = np.mod(first[0] - second[0], 2 * np.pi)
    flipped = (turn > np.pi / 2) & (turn < 3 * np.pi / 2)
    return np.where(flipped, second[0] + np.pi, second[0]), np.where(flipped, -second[1], second[1])


def _mean_line(theta: Float64, rho: Float64) -> tuple[Float64, Float64]:
    """Compute the mean of two lines in polar form, (..., 2) each, after making their normals differ least."""
    first = theta[..., 0], rho[..., 0]
    other, offset = _facing(first, (theta[..., 1], rho[..., 1]))
    x, y = np.cos(first[0]) + np.cos(other), np.sin(first[0]) + np.sin(other)
    return np.arctan2(y, x), (first[1] + offset) / 2


def _better_pairing(gap: Float64) -> Float64:
    """Return the smaller sum of distances (...) of two things from two others, given each one's, (..., 2, 2)."""
    return np.minimum(gap[..., 0, 0] + gap[..., 1, 1], gap[..., 0, 1] + gap[..., 1, 0])


def cylinder_loss(projected: Float64, reference: Float64, camera: Camera, offset_weight: float) -> Float64:
    """Compute L_cylinder: the summed line distances of the better pairing of edges plus that of the mean lines, (...).

    ``projected`` and ``reference``, (..., 2, 3) each, are homogeneous lines in normalised coordinates; they are
    broadcast together. The loss is 10 where ``projected`` is NaN.
    """
    theta, rho = polar_lines(projected, camera)
    ref_theta, ref_rho = polar_lines(reference, camera)
    one, other = (theta[..., :, None], rho[..., :, None]), (ref_theta[..., None, :], ref_rho[..., None, :])
    edges = _better_pairing(line_distance(one, other, offset_weight))
    mean = line_distance(_mean_line(theta, rho), _mean_line(ref_theta, ref_rho), offset_weight)
    return np.asarray(np.nan_to_num(edges + mean, nan=10.0))


def keypoint_loss(projected: Float64, reference: Float64) -> Float64:
    """Compute L_kpt, px: the summed distances of the better pairing of tips plus that of the mean points, (...).

    ``projected`` (..., 2, 2) and ``reference`` (2, 2) are pixels.
    """
    gap = np.linalg.norm(projected[..., :, None, :] - reference[None, :, :], axis=-1)
    means = np.linalg.norm(projected.mean(axis=-2) - reference.mean(axis=-2), axis=-1)
    return np.asarray(_better_pairing(gap) + means)
