"""Measures of how well poses explain their frame, and the reasons for which a pose is doubtful."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import LossWeights, TrustConfig
from dvrk_cmaes.evidence.distance_field import distance_field
from dvrk_cmaes.evidence.gather import Evidence, window_around
from dvrk_cmaes.evidence.joint_prior import Readings
from dvrk_cmaes.evidence.outline_noise import sampled, signed_distance
from dvrk_cmaes.evidence.straight_cut import largest_bend, shaft_width
from dvrk_cmaes.geometry import apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.refine.coarse_to_fine import is_twin
from dvrk_cmaes.pose.refine.outline import OutlineFit
from dvrk_cmaes.pose.search.losses import Terms, dist_loss, mse_loss, scale_loss
from dvrk_cmaes.pose.search.modes import HasPose
from dvrk_cmaes.pose.search.objective import pose_terms
from dvrk_cmaes.results.result import Quality
from dvrk_cmaes.silhouette import Renderer
from dvrk_cmaes.silhouette.ray_check import trace_near_outlines

Float64 = NDArray[np.float64]


def _contour_distances(silhouette: NDArray[np.bool_], points: Float64) -> Float64:
    """Compute signed distances, px, of points (N, 2) to a silhouette's outline, negative inside; inf without one."""
    if not len(points) or silhouette.all() or not silhouette.any():
        return np.full(len(points), np.inf)
    return sampled(signed_distance(silhouette), points)


def measure_quality(
    renderer: Renderer,
    evidence: Evidence,
    readings: Readings,
    modes: Sequence[HasPose],
    weights: LossWeights,
    *,
    decay: float,
    field: str,
) -> tuple[list[Quality], int]:
    """Measure overlap, losses and contour distances of all modes at full image size.

    The silhouettes are rendered as masks and checked by ray tracing along their outlines. The distance field is
    computed by the method ``field``, in a window around the mask and all silhouettes; ``decay``, px, is the distance
    over which it increases by one. Returns the quality of each mode and the number of rays traced.
    """
    poses, joints = np.stack([mode.camera_from_root for mode in modes]), np.stack([mode.joints for mode in modes])
    masks, rays = trace_near_outlines(renderer, poses, joints, renderer.masks(poses, joints))
    left, top, width, height = window_around(np.logical_or(evidence.mask, masks.any(axis=0)), 2)
    window = np.s_[top : top + height, left : left + width]
    mask, weight = evidence.mask[window], evidence.weight[window].astype(np.float64)
    around = np.pad(mask, 1)  # the distance field is undefined for a mask without background
    far = distance_field(around, field)[1:-1, 1:-1] / decay
    area = float((mask * weight).sum())
    others = pose_terms(evidence, renderer.body.instrument, readings, weights, poses, joints)
    cylinder, keypoints, deviations = others
    found = []
    for i, silhouette in enumerate(masks[:, window[0], window[1]]):
        drawn = silhouette * weight
        terms = Terms(
            mse=mse_loss(np.array([drawn.sum()]), np.array([(drawn * mask).sum()]), area) / area,
            dist=dist_loss(np.array([(drawn * far).sum()])) / area,
            scale=scale_loss(np.array([drawn.sum()]), area) / area,
            cylinder=cylinder[i : i + 1],
            keypoints=keypoints[i : i + 1],
            readings=deviations[i : i + 1],
        )
        both, either = (drawn * mask).sum(), (np.maximum(silhouette, mask) * weight).sum()
        # infinite for a silhouette outside the image: limited to the diagonal of the image
        diagonal = float(np.hypot(*evidence.mask.shape))
        signed = np.clip(_contour_distances(silhouette, evidence.contour.pixels - [left, top]), -diagonal, diagonal)
        distances = np.abs(signed) if len(signed) else np.array([diagonal])
        shaft = shaft_width(renderer.body.instrument, evidence.camera, poses[i])
        found.append(
            Quality(
                iou=float(both / max(either, 1)),
                loss=float(terms.total(weights)[0]),
                terms={name: float(value[0]) for name, value in asdict(terms).items()},
                contour_px_median=float(np.median(distances)),
                contour_px_95=float(np.percentile(distances, 95)),
                bend_px=0.0 if shaft is None else largest_bend(evidence.contour.pixels, signed, shaft),
            )
        )
    return found, rays


def _tips_out_of_view(best: HasPose, instrument: Instrument, evidence: Evidence) -> bool:
    """Return whether a jaw tip is behind the camera or outside the image."""
    pose, camera = best.camera_from_root, evidence.camera
    tips = apply(pose, instrument.tips(best.joints))
    if (tips[:, 2] <= 0).any():
        return True
    pixels = camera.project(tips)
    return bool((pixels < -0.5).any() or (pixels > [camera.width - 0.5, camera.height - 0.5]).any())


def doubts_of_fit(
    best: HasPose, quality: Quality, evidence: Evidence, instrument: Instrument, trust: TrustConfig
) -> list[str]:
    """List the reasons, in words, for which a pose does not explain its mask; empty if there are none."""
    reasons = []
    if quality.iou < trust.least_iou:
        reasons.append(f"overlap too low: IoU {quality.iou:.3f}, expected at least {trust.least_iou:.2f}")
    if quality.contour_px_95 > trust.largest_contour_px:
        reasons.append(
            f"outline residual too high: a twentieth of the mask's contour is more than "
            f"{quality.contour_px_95:.1f} px from the silhouette"
        )
    shaft = shaft_width(instrument, evidence.camera, best.camera_from_root)
    if shaft is not None and quality.bend_px > max(trust.largest_bend_px, trust.largest_bend_share * shaft):
        reasons.append(
            f"mask cut straight: along a straight line that ends it, the silhouette bends by {quality.bend_px:.1f} px"
        )
    if instrument.jaw_tips and _tips_out_of_view(best, instrument, evidence):
        reasons.append("tip out of view: a jaw tip lies outside the image")
    return reasons


def judge(
    best: OutlineFit,
    modes: Sequence[OutlineFit],
    quality: Quality,
    evidence: Evidence,
    readings: Readings,
    instrument: Instrument,
    trust: TrustConfig,
) -> list[str]:
    """List the reasons, in words, for which the best of all modes is doubtful; empty if there are none.

    ``modes`` are sorted by their score and start with ``best``.
    """
    reasons = doubts_of_fit(best, quality, evidence, instrument, trust)
    known = ~np.isnan(readings.values)
    better = min(modes, key=lambda mode: mode.outline_score)
    if best.outline_score - better.outline_score > trust.largest_outline_gap:
        reasons.append("readings against outline: a pose farther from the readings explains the mask clearly better")
    for other in modes[1:]:
        gap = other.score - best.score
        if gap >= trust.least_score_gap:
            continue
        if instrument.has_twin and is_twin(instrument, best, other):
            why = "" if known.any() else " without readings"
            reasons.append(f"twin undecided{why}: the mirror twin explains the frame nearly as well")
        else:
            reasons.append("runner-up mode too close: another pose explains the frame nearly as well")
    if not known.any():
        reasons.append("no readings: nothing tells the pose from its mirror twin")
    off = np.abs(best.joints - readings.values) / readings.sigma
    for name, sigmas in zip(instrument.joint_names, off, strict=True):
        if sigmas > trust.largest_reading_sigmas:
            reasons.append(f"far from the readings: {name} is {sigmas:.1f} times the expected error away")
    std = np.sqrt(np.diag(np.linalg.inv(best.information))[6:])
    for name, deviation, prior, read in zip(instrument.joint_names, std, readings.sigma, known, strict=True):
        if deviation >= trust.unobservable_share * prior:
            than = "its reading's" if read else "a reading's would be"
            reasons.append(
                f"joint unobservable: {name}'s standard deviation, {np.degrees(deviation):.0f} deg, is {than}"
            )
    together = float(np.nansum(off**2))
    if together > trust.largest_reading_sum and not (off > trust.largest_reading_sigmas).any():
        reasons.append("far from the readings: all joints together are farther off than readings are")
    if instrument.shaft is not None and not evidence.shaft_edges:
        reasons.append("shaft not found: no two edges in the mask could bound it")
    return reasons
