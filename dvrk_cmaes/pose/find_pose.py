"""Find the pose of the instrument in one frame from its evidence alone: search, refinement, quality, doubts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dvrk_cmaes.config import EstimateConfig, TrustConfig
from dvrk_cmaes.geometry import Float64, Posed, inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings, reading_distance
from dvrk_cmaes.pose.expected_error import (
    covariance_by_camera,
    expected_error,
    file_covariance,
    mode_probability,
    pose_covariance,
)
from dvrk_cmaes.pose.judge import judge
from dvrk_cmaes.pose.refine.coarse_to_fine import LocalSearch
from dvrk_cmaes.pose.refine.gauss_newton import Fit
from dvrk_cmaes.pose.search.global_search import SEEDS, find_candidates
from dvrk_cmaes.pose.search.starts import PoseCandidate, is_twin
from dvrk_cmaes.pose.views import FrameView, clearest_view, measure_views, pooled_quality
from dvrk_cmaes.results.result import Alternative, ExpectedError, Quality, ViewCheck
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import body_by, decimated_body

_AGAIN = 1_000_003  # added to the seed for the second search
_COARSER = 2.0  # cells of the meshes in the search's images, in cells of those in the next larger ones


@dataclass(frozen=True, eq=False)
class FoundPose:
    """The pose found in one frame and what supports it.

    ``at`` is one pose in the camera of the first view that shows the instrument, with the ``covariance``
    (6 + J, 6 + J) of its small changes; ``expected_error`` is that of tips and shaft, ``tip_probability`` that of tips
    within the limit. ``mode_probability`` is that of the pose's mode, None where a session's prediction determines the
    mode. ``reasons`` say why the pose is doubtful; none if it is not. ``camera_from_base`` (4, 4) is given where a
    session's calibration took the joints' offsets out of the readings. ``evaluations`` and ``rays`` count the
    silhouettes evaluated and the rays traced. ``views`` has the fit in each view, and ``notes`` remark on single ones.
    """

    at: Posed
    covariance: Float64
    quality: Quality
    reasons: tuple[str, ...]
    evaluations: int
    rays: int
    expected_error: ExpectedError
    tip_probability: float
    mode_probability: float | None = None
    alternatives: tuple[Alternative, ...] = ()
    camera_from_base: Float64 | None = None
    views: tuple[ViewCheck, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def stated(self) -> dict[str, Any]:
        """What a result states by the names of these fields."""
        names = ["covariance", "quality", "expected_error", "tip_probability", "mode_probability", "alternatives"]
        return {name: getattr(self, name) for name in (*names, "evaluations", "rays")}


def find_pose(
    views: Sequence[FrameView],
    decimated: Body,
    readings: Readings,
    config: EstimateConfig,
    start: Sequence[PoseCandidate] = (),
) -> FoundPose:
    """Find the pose that best explains the evidence of the views of one frame.

    The first view is the reference: its ``view_from_camera`` is the identity, and the pose is in its camera. The view
    with the largest mask is searched; a search of all would cost more and find the same modes, since the eyes of an
    endoscope see nearly the same. What is found, or else the candidates to ``start`` from, is refined, ranked and
    judged on all of them. Where the best of it does not explain the masks, another search adds candidates.
    ``decimated`` is the instrument with fewer faces, for the small images of the search.
    """
    instrument = decimated.instrument
    local = LocalSearch(views, decimated, readings, config)
    candidates, evaluations, rays = list(start), 0, 0
    pixel_scale = views[0].evidence.camera.pixel_scale
    for again in (False, True):
        if not start:
            seeded = replace(config, seed=(config.seed + _AGAIN) % SEEDS) if again else config
            searched, drawing = _searched(views, decimated, readings, seeded)
            candidates += searched
            evaluations += drawing.poses
            rays += drawing.rays
        modes, rotations = local.refine(candidates)
        best = modes[0]
        at = Posed.stacked([mode.at for mode in modes])
        of_modes, confirming = measure_views(views, readings, at, config, traced=1)
        of_views = [qualities[0] for qualities in of_modes]
        pooled, *others = map(pooled_quality, zip(*of_modes, strict=True))
        rays += confirming
        covariance = pose_covariance(modes, pooled)
        probability = mode_probability(modes, expected_error(instrument, best.at, covariance).of_tips_mm)
        if start or not _lacks_fit(of_views, probability, config.trust, pixel_scale):
            break
        candidates = list(modes)
    camera = views[0].evidence.camera
    of_camera = covariance_by_camera(instrument, camera, best.at, file_covariance(camera, config.camera))
    expected = expected_error(instrument, best.at, covariance, of_camera)
    of_rig = [(np.zeros(3), np.zeros((3, 3))), *rotations]  # the first view is the reference
    checks = tuple(
        ViewCheck(view.name, quality, np.degrees(turn), np.degrees(np.degrees(spread)))
        for view, quality, (turn, spread) in zip(views, of_views, of_rig, strict=True)
    )
    drawing_views = [*local.renderers, *(view.renderer for view in views)]
    reasons, notes, of_tips = judge(modes, views, checks, expected, probability, readings, config.trust)
    return FoundPose(
        at=best.at,
        covariance=covariance,
        quality=pooled,
        reasons=tuple(reasons),
        evaluations=evaluations + sum(each.poses for each in drawing_views),
        rays=rays + sum(each.rays for each in drawing_views),
        expected_error=expected,
        mode_probability=probability,
        tip_probability=of_tips,
        alternatives=_alternatives(instrument, readings, modes, others),
        views=checks,
        notes=tuple(notes),
    )


def _searched(
    views: Sequence[FrameView], decimated: Body, readings: Readings, config: EstimateConfig
) -> tuple[list[PoseCandidate], Renderer]:
    """Search the clearest view; returns candidates in the reference camera, and the renderer used."""
    view = clearest_view(views)
    body = body_by(decimated_body(decimated, _COARSER * config.search.detail_m), config.silhouette.method)
    coarse = Renderer(body, view.evidence.camera, threads=config.threads)
    found, drawing = find_candidates(coarse, view.evidence, readings, config)
    camera_from_view = inverse(view.view_from_camera)
    return [PoseCandidate(each.at.seen_from(camera_from_view), each.score) for each in found], drawing


def _lacks_fit(qualities: Sequence[Quality], of_mode: float, trust: TrustConfig, pixel_scale: float) -> bool:
    """Return whether the mode is in doubt and no view is explained, so that another search may find a better pose."""
    return of_mode < trust.least_probability and all(
        quality.iou < trust.least_iou or quality.distal_px > trust.largest_distal_px * pixel_scale
        for quality in qualities
    )


def _alternatives(
    instrument: Instrument, readings: Readings, modes: Sequence[Fit], qualities: Sequence[Quality]
) -> tuple[Alternative, ...]:
    """Describe all modes of a frame but the first, by their qualities, and how they relate to the first."""
    best = modes[0].at
    return tuple(
        Alternative(
            camera_from_root=mode.at.pose,
            joints=dict(zip(instrument.joint_names, mode.at.joints.tolist(), strict=True)),
            loss=quality.loss,
            iou=quality.iou,
            relation="mirror twin" if instrument.has_twin and is_twin(instrument, best, mode.at) else "other mode",
            reading_distance_deg=reading_distance(readings, mode.at.joints),
        )
        for mode, quality in zip(modes[1:], qualities, strict=True)
    )
