"""The paper's losses, each its own function, batched over candidates.

The silhouette's terms are sums of S times fixed images, so they come from a renderer's sums without making an image:
S takes only the values 0 and 1 along a line, hence S^2 = S. L_dist is such a sum as it stands. The objective divides
them by the mask's area, which makes them comparable between image sizes. Equation names follow "Differentiable
Rendering-based Pose Estimation for Surgical Robotic Instruments" (Liang et al., 2025).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import LossWeights

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Terms:
    """Loss terms of C candidates, (C,) each; what has no evidence is zero."""

    mse: Float64
    dist: Float64
    scale: Float64
    cylinder: Float64
    keypoints: Float64
    readings: Float64

    def total(self, weights: LossWeights) -> Float64:
        """Weighted sum of all terms, (C,)."""
        return np.asarray(sum(getattr(weights, f.name) * getattr(self, f.name) for f in fields(self)))


def mse_loss(area: Float64, overlap: Float64, mask_area: float) -> Float64:
    """L_mse = sum (S - M)^2 from sum S, sum S M and sum M^2, for a silhouette of zeros and ones."""
    return area - 2 * overlap + mask_area


def dist_loss(far: Float64) -> Float64:
    """L_dist = sum S D, from that very sum over the silhouette."""
    return far


def scale_loss(area: Float64, mask_area: float) -> Float64:
    """L_scale = |sum S - sum M|."""
    return np.abs(area - mask_area)


def polar_lines(lines: Float64, camera: Camera) -> tuple[Float64, Float64]:
    """Homogeneous lines (..., 3) in normalised coordinates as u cos(theta) + v sin(theta) = rho in ideal pixels.

    Pixels without the lens's distortion, in which straight edges stay straight. theta in rad, rho in px.
    """
    a, b, c = lines[..., 0] / camera.fx, lines[..., 1] / camera.fy, lines[..., 2]
    c = c - a * camera.cx - b * camera.cy
    norm = np.maximum(np.hypot(a, b), 1e-12)
    return np.arctan2(b, a), -c / norm


def line_distance(a: tuple[Float64, Float64], b: tuple[Float64, Float64], offset_weight: float) -> Float64:
    """Distance of lines in polar form: their angle, rad, plus ``offset_weight`` (1/px) times their offset, px.

    A line may be written with its normal either way: (theta, rho) and (theta + pi, -rho) are the same.
    """
    turn = np.mod(a[0] - b[0], 2 * np.pi)
    flipped = (turn > np.pi / 2) & (turn < 3 * np.pi / 2)
    angle = np.minimum(np.mod(turn, np.pi), np.pi - np.mod(turn, np.pi))
    return np.asarray(angle + offset_weight * np.abs(a[1] - np.where(flipped, -b[1], b[1])))


def _mean_line(first: tuple[Float64, Float64], second: tuple[Float64, Float64]) -> tuple[Float64, Float64]:
    """Mean of two lines, both written with normals less than 90 degrees apart."""
    turn = np.mod(second[0] - first[0], 2 * np.pi)
    flipped = (turn > np.pi / 2) & (turn < 3 * np.pi / 2)
    theta = np.where(flipped, second[0] + np.pi, second[0])
    rho = np.where(flipped, -second[1], second[1])
    x, y = np.cos(first[0]) + np.cos(theta), np.sin(first[0]) + np.sin(theta)
    return np.arctan2(y, x), (first[1] + rho) / 2


def cylinder_loss(projected: Float64, reference: Float64, camera: Camera, offset_weight: float) -> Float64:
    """L_cylinder: summed distance of the better pairing of edges, plus the distance of the two mean lines.

    ``projected`` (..., 2, 3) and ``reference`` (2, 3) are homogeneous lines in normalised coordinates.
    """
    theta, rho = polar_lines(projected, camera)
    ref_theta, ref_rho = polar_lines(reference, camera)
    p = [(theta[..., i], rho[..., i]) for i in range(2)]
    r = [(ref_theta[i], ref_rho[i]) for i in range(2)]
    straight = line_distance(p[0], r[0], offset_weight) + line_distance(p[1], r[1], offset_weight)
    crossed = line_distance(p[0], r[1], offset_weight) + line_distance(p[1], r[0], offset_weight)
    mean = line_distance(_mean_line(*p), _mean_line(*r), offset_weight)
    return np.asarray(np.nan_to_num(np.minimum(straight, crossed) + mean, nan=10.0))


def keypoint_loss(projected: Float64, reference: Float64) -> Float64:
    """L_kpt: summed distance, px, of the better pairing of tips, plus the distance of the two mean points.

    ``projected`` (..., 2, 2) and ``reference`` (2, 2) are pixels.
    """
    gap = np.linalg.norm(projected[..., :, None, :] - reference[None, :, :], axis=-1)
    pairings = np.minimum(gap[..., 0, 0] + gap[..., 1, 1], gap[..., 0, 1] + gap[..., 1, 0])
    means = np.linalg.norm(projected.mean(axis=-2) - reference.mean(axis=-2), axis=-1)
    return np.asarray(pairings + means)
