"""Fit of one frame's pose and joints to its outline, with the prediction of its session as a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig, OutlineConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.joint_prior import Readings
from dvrk_cmaes.evidence.outline_noise import measure_noise
from dvrk_cmaes.pose.refine.outline import OutlineRefiner
from dvrk_cmaes.pose.refine.priors import PosePrior
from dvrk_cmaes.silhouette import Renderer

Float64 = NDArray[np.float64]

PoseAndJoints = tuple[Float64, Float64]
"""camera_from_root (4, 4) and joints (J,), rad."""

_KEPT = 2  # fits at half the image size that are continued at the whole size


@dataclass(frozen=True, eq=False)
class FrameFit:
    """A frame's pose camera_from_root (4, 4) and joints (J,), rad, fitted with the session's prior.

    ``information`` (D, D), D = 6 + J, is the Gauss-Newton matrix of the outline alone at the fit, and ``slope`` (D,)
    the gradient of half its sum of squares, for changes in the root's axes, m and rad. ``score`` is the negative
    log-likelihood of the fit, ``evaluations`` the number of silhouettes that were rendered. ``iou`` is the intersection
    over union of the fit's silhouette and the mask; ``own_iou`` is that of the frame's own estimate, 0 if not given.
    """

    camera_from_root: Float64
    joints: Float64
    information: Float64
    slope: Float64
    score: float
    evaluations: int = 0
    iou: float = 1.0
    own_iou: float = 0.0

    def step_to(self, expected: PosePrior) -> float:
        """Return how far the fit would move with another prior, in standard deviations per parameter.

        The outline's terms are taken as quadratic.
        """
        information = self.information + expected.information
        slope = self.slope + expected.information @ expected.deviation(self.camera_from_root, self.joints)
        step = np.linalg.solve(information, slope)
        return float(np.sqrt(max(float(step @ slope), 0.0) / len(step)))

    def without_outline(self) -> FrameFit:
        """Return the fit with zero information and slope, so that it does not influence the calibration."""
        return replace(self, information=np.zeros_like(self.information), slope=np.zeros_like(self.slope))


def fit_frame(
    renderer: Renderer,
    evidence: Evidence,
    readings: Readings,
    config: EstimateConfig,
    expected: PosePrior,
    starts: Sequence[PoseAndJoints],
    own_estimate: PoseAndJoints | None,
    own_camera: Camera | None = None,
) -> FrameFit:
    """Fit a frame from several starts, and return the fit with the best score.

    Parameters
    ----------
    renderer, evidence, config
        The renderer at full detail, the frame's evidence and all settings.
    readings
        The instrument's joints; only their limits are used, since ``expected`` contains the readings.
    expected
        The session's prediction, which is the prior.
    starts
        Starting poses and joints, at least one.
    own_estimate
        The frame's pose and joints estimated without the session. The noise of the outline is measured from its
        residuals, to which the session's prior has not contributed. If None, the noise is estimated during the fit.
    own_camera
        The camera of ``own_estimate``, for images of the same size, where it is not the evidence's.
    """
    limits = _limits(renderer, readings)
    own_renderer = renderer if own_camera is None else Renderer(renderer.body, own_camera, threads=renderer.threads)
    outline = _outline_config(own_renderer, evidence, config, own_estimate)
    shrinks = (2, 1) if len(starts) > 1 and evidence.camera.width >= 320 else (1,)
    poses, joints = np.stack([pose for pose, _ in starts]), np.stack([joint for _, joint in starts])
    count = 0
    for shrink in shrinks:
        refiner = OutlineRefiner(renderer, evidence, limits, outline, shrink=shrink, expected=expected)
        if own_estimate is not None:
            refiner.set_noise_at(*own_estimate, camera=own_camera)
        fits = sorted(refiner.refine_all(poses, joints), key=lambda fit: fit.score)[:_KEPT]
        poses, joints = np.stack([fit.camera_from_root for fit in fits]), np.stack([fit.joints for fit in fits])
        count += refiner.silhouettes
    best = fits[0]
    prior_information, prior_slope = np.zeros_like(best.information), np.zeros(len(best.information))
    refiner.priors.add(prior_information, prior_slope, best.camera_from_root, best.joints)
    overlaps = [_intersection_over_union(renderer, evidence, (best.camera_from_root, best.joints))]
    if own_estimate is not None:
        overlaps.append(_intersection_over_union(own_renderer, evidence, own_estimate))
    # At the optimum, the slopes of outline and priors add up to zero.
    information = best.information - prior_information
    return FrameFit(best.camera_from_root, best.joints, information, -prior_slope, best.score, count, *overlaps)


def camera_terms(
    renderer: Renderer,
    evidence: Evidence,
    readings: Readings,
    config: EstimateConfig,
    fitted: PoseAndJoints,
    own_estimate: PoseAndJoints,
    camera: Camera,
) -> tuple[Float64, Float64]:
    """Compute the outline's information and slope about a pose and joints and about the camera.

    ``fitted`` are pose and joints with the camera ``camera``, whose image has the evidence's size. The other arguments
    are as in `fit_frame`, with the evidence's own camera; values as in `OutlineRefiner.terms_with_camera`.
    """
    outline = _outline_config(renderer, evidence, config, own_estimate)
    seen = replace(evidence, camera=camera)
    refiner = OutlineRefiner(renderer, seen, _limits(renderer, readings), outline)
    refiner.set_noise_at(*own_estimate, camera=evidence.camera)
    return refiner.terms_with_camera(*fitted)


def _limits(renderer: Renderer, readings: Readings) -> Readings:
    """Return the limits of the joints without their readings."""
    return replace(readings, values=np.full(len(renderer.body.instrument.joint_names), np.nan))


def _outline_config(
    renderer: Renderer, evidence: Evidence, config: EstimateConfig, own_estimate: PoseAndJoints | None
) -> OutlineConfig:
    """Return the settings of the refinement, with the correlation length of the residuals at the own estimate."""
    outline = replace(config.refine.outline, cauchy=config.session.cauchy)
    if own_estimate is None:
        return outline
    return replace(outline, correlation=measure_noise(evidence.contour, _silhouette(renderer, own_estimate)).length)


def _intersection_over_union(renderer: Renderer, evidence: Evidence, estimate: PoseAndJoints) -> float:
    """Compute the intersection over union of an estimate's silhouette and the mask, without ignored pixels."""
    silhouette = _silhouette(renderer, estimate)
    both, either = (((a * evidence.weight).sum()) for a in (silhouette & evidence.mask, silhouette | evidence.mask))
    return float(both / max(either, 1))


def _silhouette(renderer: Renderer, estimate: PoseAndJoints) -> NDArray[np.bool_]:
    """Render the silhouette (H, W) of an estimate."""
    return np.asarray(renderer.masks(estimate[0][None], estimate[1][None])[0])
