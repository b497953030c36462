"""Fit of one frame's pose and joints to its outline, with the prediction of its session as a prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.own_estimate import OwnEstimate, overlap, silhouettes
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig, OutlineConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.joint_refiner import JointRefiner
from dvrk_cmaes.pose.refine.outline import OutlineRefiner
from dvrk_cmaes.pose.refine.priors import PosePrior
from dvrk_cmaes.pose.search.modes import Posed
from dvrk_cmaes.pose.views import FrameView
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
        step, slope = self._step(expected)
        return float(np.sqrt(max(-float(step @ slope), 0.0) / len(step)))

    def towards(self, expected: PosePrior) -> PoseAndJoints:
        """Return where the fit would be with another prior, as in `step_to`."""
        there = self.moved_to(expected)
        return there.camera_from_root, there.joints

    def moved_to(self, expected: PosePrior) -> FrameFit:
        """Return the fit where it would be with another prior, as in `step_to`, with the outline's slope there."""
        step = self._step(expected)[0]
        pose, joints = moved(self.camera_from_root, step[:6]), self.joints + step[6:]
        return replace(self, camera_from_root=pose, joints=joints, slope=self.slope + self.information @ step)

    def _step(self, expected: PosePrior) -> tuple[Float64, Float64]:
        """Return the change (D,) of the fit with another prior, and the slope (D,) there, whose minimum it is."""
        information = self.information + expected.information
        slope = self.slope + expected.information @ expected.deviation(self.camera_from_root, self.joints)
        return -np.asarray(np.linalg.solve(information, slope), dtype=np.float64), slope

    def without_outline(self) -> FrameFit:
        """Return the fit with zero information and slope, so that it does not influence the calibration."""
        return replace(self, information=np.zeros_like(self.information), slope=np.zeros_like(self.slope))


def fit_frame(
    views: Sequence[FrameView],
    readings: Readings,
    config: EstimateConfig,
    expected: PosePrior,
    starts: Sequence[PoseAndJoints],
    own_estimate: OwnEstimate | None,
    own_camera: Camera | None = None,
    *,
    confirm: bool = True,
) -> FrameFit:
    """Fit a frame from several starts, and return the fit with the best score.

    Parameters
    ----------
    views
        The views that show the instrument, with the frame's evidence and renderers at full detail.
    readings
        The instrument's joints; only their limits are used, since ``expected`` contains the readings.
    config
        All settings.
    expected
        The session's prediction, which is the prior.
    starts
        Starting poses and joints, at least one.
    own_estimate
        The frame's estimate without the session. The noise of the outlines is measured from its residuals, to which
        the session's prior has not contributed. If None, the noise is estimated during the fit.
    own_camera
        The camera of ``own_estimate``, for images of the same size, where it is not that of the single view.
    confirm
        As in `OutlineRefiner`; several views are always confirmed.
    """
    main = views[0]
    shrinks = (2, 1) if len(starts) > 1 and main.evidence.camera.width >= 320 else (1,)
    poses, joints = np.stack([pose for pose, _ in starts]), np.stack([joint for _, joint in starts])
    count = 0
    for shrink in shrinks:
        refiner = _refiner(views, readings, config, own_estimate, shrink, expected, confirm=confirm)
        if own_estimate is not None and shrink == 1 and own_estimate.noise is not None:
            refiner.noise = own_estimate.noise
        elif own_estimate is not None:
            _set_noise(refiner, own_estimate, own_camera)
        fits = sorted(refiner.refine_all(poses, joints), key=lambda fit: fit.score)[:_KEPT]
        poses, joints = np.stack([fit.camera_from_root for fit in fits]), np.stack([fit.joints for fit in fits])
        count += refiner.silhouettes
    best = fits[0]
    of_priors = refiner if isinstance(refiner, OutlineRefiner) else refiner.views[0][0]
    seen = main.view_from_camera @ best.camera_from_root
    (prior_information,), (prior_slope,) = of_priors.priors.terms(seen[None], best.joints[None])
    iou = overlap(views, silhouettes(views, Posed(best.camera_from_root, best.joints)))
    own_iou = 0.0 if own_estimate is None else own_estimate.iou
    # At the optimum, the slopes of outline and priors add up to zero.
    information = best.information - prior_information
    return FrameFit(best.camera_from_root, best.joints, information, -prior_slope, best.score, count, iou, own_iou)


def with_noise(
    own_estimate: OwnEstimate, views: Sequence[FrameView], readings: Readings, config: EstimateConfig
) -> OwnEstimate:
    """Return a frame's own estimate with the noise of the residuals there; arguments as in `fit_frame`."""
    refiner = _refiner(views, readings, config, own_estimate)
    _set_noise(refiner, own_estimate, None)
    return replace(own_estimate, noise=refiner.noise)


def _refiner(
    views: Sequence[FrameView],
    readings: Readings,
    config: EstimateConfig,
    own_estimate: OwnEstimate | None,
    shrink: int = 1,
    expected: PosePrior | None = None,
    *,
    confirm: bool = True,
) -> OutlineRefiner | JointRefiner:
    """Return the refiner of a frame's views at 1 / ``shrink`` of the image size; arguments as in `fit_frame`."""
    main = views[0]
    limits = _limits(main.renderer, readings)
    settings = [_outline_config(config, own_estimate, k) for k in range(len(views))]
    if len(views) == 1 and np.array_equal(main.view_from_camera, np.eye(4)):
        return OutlineRefiner(
            main.renderer, main.evidence, limits, settings[0], shrink=shrink, expected=expected, confirm=confirm
        )
    renderers, shrinks = [view.renderer for view in views], [shrink] * len(views)
    return JointRefiner.of_views(views, renderers, limits, settings, shrinks=shrinks, expected=expected)


def _set_noise(refiner: OutlineRefiner | JointRefiner, own_estimate: OwnEstimate, camera: Camera | None) -> None:
    """Measure the noise at the own estimate; ``camera`` is that of the own estimate, as in `fit_frame`."""
    if isinstance(refiner, OutlineRefiner):
        refiner.set_noise_at(own_estimate.camera_from_root, own_estimate.joints, camera=camera)
    else:
        refiner.set_noise_at(own_estimate.camera_from_root, own_estimate.joints)


def camera_terms(
    renderer: Renderer,
    evidence: Evidence,
    readings: Readings,
    config: EstimateConfig,
    fitted: PoseAndJoints,
    own_estimate: OwnEstimate,
    camera: Camera,
) -> tuple[Float64, Float64]:
    """Compute the outline's information and slope about a pose and joints and about the camera.

    ``fitted`` are pose and joints with the camera ``camera``, whose image has the evidence's size. The other arguments
    are as in `fit_frame`, with the evidence's own camera; values as in `OutlineRefiner.terms_with_camera`.
    """
    seen = replace(evidence, camera=camera)
    refiner = OutlineRefiner(renderer, seen, _limits(renderer, readings), _outline_config(config, own_estimate, 0))
    if len(own_estimate.lengths) == 1 and own_estimate.noise is not None:
        refiner.noise = own_estimate.noise
    else:  # that of this view alone
        _set_noise(refiner, own_estimate, evidence.camera)
    return refiner.terms_with_camera(*fitted)


def _limits(renderer: Renderer, readings: Readings) -> Readings:
    """Return the limits of the joints without their readings."""
    return replace(readings, values=np.full(len(renderer.body.instrument.joint_names), np.nan))


def _outline_config(config: EstimateConfig, own_estimate: OwnEstimate | None, view: int) -> OutlineConfig:
    """Return the settings of the refinement, with the correlation length of the residuals at the own estimate."""
    outline = replace(config.refine.outline, cauchy=config.session.cauchy)
    return outline if own_estimate is None else replace(outline, correlation=own_estimate.lengths[view])
