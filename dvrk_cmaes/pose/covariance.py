"""Covariance of the pose of a frame: of its best mode, and of other modes near it.

Where the mask's contour is far from the silhouette at wrist and jaws, tissue or another tool is in front of them. The
errors are then larger than the outline's noise tells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.evidence.outline_noise import OutlineNoise
from dvrk_cmaes.geometry import Float64, rotation_angle
from dvrk_cmaes.pose.probability import mode_weights
from dvrk_cmaes.pose.refine.gauss_newton import Fit
from dvrk_cmaes.results.result import Quality

_NEAR = np.deg2rad(60.0)  # rotation between modes that are covered by one covariance
_DISTAL_PX = 2.2  # distance of the contour at wrist and jaws, beyond which the standard deviations grow with it


def _occlusion_factor(quality: Quality, pixel_scale: float = 1.0) -> float:
    """Return the factor on a covariance for contour that is far off at wrist and jaws.

    A frame by itself takes its depth from what it shows of these, so that what a model is off by there counts in
    pixels; one that its session supports does not.
    """
    return max(1.0, quality.distal_px / (_DISTAL_PX * pixel_scale)) ** 2


def rough_covariance(covariance: Float64, noise: OutlineNoise, quality: Quality, pixel_scale: float) -> Float64:
    """Widen the covariance (6 + J, 6 + J) of a frame that was fitted with its session by what a rough contour adds.

    ``covariance`` is that of a Gauss-Newton fit, which holds for errors that are small and normal; ``pixel_scale`` is
    that of the camera.
    """
    return covariance * noise.inflation(pixel_scale) * _occlusion_factor(quality, pixel_scale)


def pose_covariance(modes: Sequence[Fit], quality: Quality) -> Float64:
    """Return the covariance (6 + J, 6 + J) of small changes of the first mode, whose ``quality`` is given.

    It includes the other modes within 60 degrees, each with its share of the probability. Modes farther away, such as
    the mirror twin, are not a small change of the pose; they are in the mode's probability.
    """
    best, weights = modes[0], mode_weights(modes)
    covariance = np.linalg.inv(best.information) * _occlusion_factor(quality)
    for mode, weight in zip(modes[1:], weights[1:], strict=True):
        if rotation_angle(best.at.pose, mode.at.pose) < _NEAR:
            apart = mode.at.minus(best.at)
            covariance += weight / (weight + weights[0]) * np.outer(apart, apart)
    return np.asarray(covariance, dtype=np.float64)
