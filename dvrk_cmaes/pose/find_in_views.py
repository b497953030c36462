"""Find the pose of the instrument in one frame from several views: search in one, refinement on all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import inverse
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.covariance import pose_covariance
from dvrk_cmaes.pose.expected_error import expected_error
from dvrk_cmaes.pose.find_pose import FoundPose, alternatives_of
from dvrk_cmaes.pose.mode_probability import mode_probability
from dvrk_cmaes.pose.quality import measure_quality
from dvrk_cmaes.pose.refine.joint_search import JointSearch
from dvrk_cmaes.pose.search.global_search import Candidate, find_candidates
from dvrk_cmaes.pose.search.modes import HasPose
from dvrk_cmaes.pose.view_doubts import judge_views
from dvrk_cmaes.pose.views import FrameView, clearest_view
from dvrk_cmaes.results.result import Quality, ViewCheck
from dvrk_cmaes.silhouette import Body, Renderer

Float64 = NDArray[np.float64]


def find_pose_in_views(
    views: Sequence[FrameView],
    decimated: Body,
    readings: Readings,
    config: EstimateConfig,
    start: Sequence[Candidate] = (),
) -> FoundPose:
    """Find the pose that best explains the evidence of two or more views of one frame.

    The first view is the reference: its ``view_from_camera`` is the identity, and the pose is in its camera. The view
    with the largest mask is searched; a search of all would cost more and find the same modes, since the eyes of an
    endoscope see nearly the same. What is found, or else the candidates to ``start`` from, is refined, ranked and
    judged on all of them.
    """
    instrument = decimated.instrument
    seen, evaluations, rays = list(start), 0, 0
    if not seen:
        searched = clearest_view(views)
        coarse = Renderer(decimated, searched.evidence.camera, threads=config.threads)
        candidates, objective = find_candidates(coarse, searched.evidence, readings, config)
        camera_from_view = inverse(searched.view_from_camera)
        seen = [Candidate(camera_from_view @ each.camera_from_root, each.joints, each.score) for each in candidates]
        evaluations, rays = objective.evaluations, objective.renderer.rays
    local = JointSearch(views, decimated, readings, config)
    modes = local.refine(seen)
    best = modes[0]
    of_views, confirming = measure_views(views, readings, modes, config)
    qualities = [pooled_quality(of_mode) for of_mode in zip(*of_views, strict=True)]
    covariance = pose_covariance(modes, qualities[0])
    expected = expected_error(instrument, best.camera_from_root, best.joints, covariance)
    probability = mode_probability(modes, expected.of_tips_mm)
    checks = tuple(
        ViewCheck(view.name, quality[0], np.degrees(turn), np.degrees(np.degrees(spread)))
        for view, quality, (turn, spread) in zip(views, of_views, local.rotations, strict=True)
    )
    reasons, notes = judge_views(modes, views, checks, expected, probability, readings, instrument, config.trust)
    return FoundPose(
        camera_from_root=best.camera_from_root,
        joints=best.joints,
        covariance=covariance,
        quality=qualities[0],
        reasons=tuple(reasons),
        evaluations=evaluations + local.silhouettes + sum(view.renderer.poses for view in views),
        rays=rays + local.rays + sum(view.renderer.rays for view in views) + confirming,
        expected_error=expected,
        mode_probability=probability,
        alternatives=alternatives_of(instrument, readings, modes, qualities),
        views=checks,
        notes=tuple(notes),
    )


def pooled_quality(qualities: Sequence[Quality]) -> Quality:
    """Return the quality of a pose in several views: means, and the largest of what tells a cut or occluded mask."""
    names = ("iou", "loss", "contour_px_median", "steady_share")
    means = {name: float(np.mean([getattr(quality, name) for quality in qualities])) for name in names}
    largest = {name: max(getattr(quality, name) for quality in qualities) for name in ("contour_px_95", "bend_px")}
    terms = {name: float(np.mean([quality.terms[name] for quality in qualities])) for name in qualities[0].terms}
    distal = float(np.sqrt(np.mean([quality.distal_px**2 for quality in qualities])))
    return Quality(**{**asdict(qualities[0]), **means, **largest, "terms": terms, "distal_px": distal})


def measure_views(
    views: Sequence[FrameView], readings: Readings, modes: Sequence[HasPose], config: EstimateConfig
) -> tuple[list[list[Quality]], int]:
    """Measure the quality of each mode in each view; returns a list of the modes' for each view, and the rays traced.

    The readings count in every view, so that the mean of the losses has them once.
    """
    found, rays = [], 0
    for view in views:
        seen = [view.sees(mode) for mode in modes]
        qualities, traced = measure_quality(
            view.renderer,
            view.evidence,
            readings,
            seen,
            config.weights,
            decay=config.decay_px,
            field=config.distance_field,
        )
        found.append(qualities)
        rays += traced
    return found, rays
