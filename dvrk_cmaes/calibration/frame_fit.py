"""One frame against what its session expects: its outline fitted with that in mind, and what the outline alone says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.joint_prior import Readings
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.refine.outline import OutlineRefiner
from dvrk_cmaes.pose.refine.priors import PosePrior
from dvrk_cmaes.silhouette import Renderer

Float64 = NDArray[np.float64]

PoseAndJoints = tuple[Float64, Float64]
"""camera_from_root (4, 4) and joints (J,), rad."""

_KEPT = 2  # of the starts, from half the image size to the whole


@dataclass(frozen=True, eq=False)
class FrameView:
    """A frame's best pose (4, 4) and joints (J,) with what was expected in mind, and what its outline alone says there.

    The outline is worth ``information`` (D, D), D = 6 + J, and pulls with ``slope`` (D,), the gradient of half its sum
    of squares over the small changes in the root's axes. ``score`` is the fit's negative log-likelihood,
    ``evaluations`` the silhouettes that it took. ``iou`` is its overlap with the mask, ``own_iou`` that of the frame's
    pose by itself, where there is one.
    """

    camera_from_root: Float64
    joints: Float64
    information: Float64
    slope: Float64
    score: float
    evaluations: int = 0
    iou: float = 1.0
    own_iou: float = 0.0

    def without_outline(self) -> FrameView:
        """Return a view that tells nothing: the frame is not what the session takes it for."""
        return replace(self, information=np.zeros_like(self.information), slope=np.zeros_like(self.slope))


def unread(instrument: Instrument, readings: Readings) -> Readings:
    """Return the limits alone: the session's expectation has the readings in it."""
    return replace(readings, values=np.full(len(instrument.joint_names), np.nan))


def fit_frame(
    renderer: Renderer,
    evidence: Evidence,
    readings: Readings,
    config: EstimateConfig,
    expected: PosePrior,
    starts: Sequence[PoseAndJoints],
    own: PoseAndJoints | None,
) -> FrameView:
    """Fit a frame from several starts with an expectation; the best of them.

    ``own`` is the frame's pose fitted to nothing but its outline and readings: what that leaves over is the outline's
    noise, while what an expectation leaves over is none. Without it the noise is that of the fit.
    """
    limits = unread(renderer.body.instrument, readings)
    outline = replace(config.refine.outline, cauchy=config.session.cauchy)
    if own is not None:
        outline = replace(outline, correlation=noise_of(renderer, evidence, own).length)
    shrinks = (2, 1) if len(starts) > 1 and evidence.camera.width >= 320 else (1,)
    poses, joints = np.stack([pose for pose, _ in starts]), np.stack([joint for _, joint in starts])
    count = 0
    for shrink in shrinks:
        refiner = OutlineRefiner(renderer, evidence, limits, outline, shrink=shrink, expected=expected)
        if own is not None:
            refiner.balance_at(*own)
        fits = sorted(refiner.refine_all(poses, joints), key=lambda fit: fit.score)[:_KEPT]
        poses, joints = np.stack([fit.camera_from_root for fit in fits]), np.stack([fit.joints for fit in fits])
        count += refiner.silhouettes
    best = fits[0]
    priors, pull = np.zeros_like(best.information), np.zeros(len(best.information))
    refiner.priors.add(priors, pull, best.camera_from_root, best.joints)
    overlaps = [
        overlap(renderer, evidence, at) for at in [(best.camera_from_root, best.joints), *([own] if own else [])]
    ]
    # At the end of a refinement outline and priors pull alike.
    return FrameView(best.camera_from_root, best.joints, best.information - priors, -pull, best.score, count, *overlaps)


def overlap(renderer: Renderer, evidence: Evidence, at: PoseAndJoints) -> float:
    """Intersection of a pose's silhouette and the mask over their union, ignored pixels left out."""
    silhouette = renderer.masks(at[0][None], at[1][None])[0]
    both, either = (((a * evidence.weight).sum()) for a in (silhouette & evidence.mask, silhouette | evidence.mask))
    return float(both / max(either, 1))


def noise_of(renderer: Renderer, evidence: Evidence, own: PoseAndJoints) -> OutlineNoise:
    """Measure the noise of a frame's outline against a pose and joints."""
    return measure_noise(evidence.contour, renderer.masks(own[0][None], own[1][None])[0])
