"""Find the pose of the instrument in one frame from its evidence alone: search, refinement, quality, doubts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings, reading_distance
from dvrk_cmaes.pose.covariance import pose_covariance
from dvrk_cmaes.pose.doubts import judge
from dvrk_cmaes.pose.expected_error import expected_error
from dvrk_cmaes.pose.mode_probability import mode_probability
from dvrk_cmaes.pose.quality import measure_quality
from dvrk_cmaes.pose.refine.coarse_to_fine import LocalSearch, is_twin
from dvrk_cmaes.pose.refine.outline import OutlineFit
from dvrk_cmaes.pose.search.global_search import Candidate, find_candidates
from dvrk_cmaes.results.result import Alternative, ExpectedError, Quality, ViewCheck
from dvrk_cmaes.silhouette import Body, Renderer

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FoundPose:
    """The pose found in one frame and what supports it.

    ``camera_from_root`` (4, 4) and ``joints`` (J,), rad, have the ``covariance`` (6 + J, 6 + J) of the small changes
    [t, r, joints] in the root's axes; ``expected_error`` is that of tips and shaft. ``mode_probability`` is that of the
    pose's mode, None where a session's prediction tells the mode. ``reasons`` say why the pose is doubtful; none if it
    is not. ``camera_from_base`` (4, 4) is given where a session's calibration took the joints' offsets out of the
    readings. ``evaluations`` and ``rays`` count the silhouettes evaluated and the rays traced. Where several views were
    used, ``views`` has the fit in each, and ``notes`` remark on single ones.
    """

    camera_from_root: Float64
    joints: Float64
    covariance: Float64
    quality: Quality
    reasons: tuple[str, ...]
    evaluations: int
    rays: int
    expected_error: ExpectedError
    mode_probability: float | None = None
    alternatives: tuple[Alternative, ...] = ()
    camera_from_base: Float64 | None = None
    views: tuple[ViewCheck, ...] = ()
    notes: tuple[str, ...] = ()


def find_pose(
    renderer: Renderer,
    decimated: Body,
    evidence: Evidence,
    readings: Readings,
    config: EstimateConfig,
    start: Sequence[Candidate] = (),
) -> FoundPose:
    """Find the pose that best explains the evidence of one frame.

    ``renderer`` draws the instrument at full detail in the frame's camera; ``decimated`` is the same instrument with
    fewer faces, for the small images of the search. Where there are candidates to ``start`` from, these are refined,
    and nothing is searched.
    """
    instrument = renderer.body.instrument
    coarse = Renderer(decimated, evidence.camera, threads=config.threads)
    candidates, searched, traced = list(start), 0, 0
    if not candidates:
        candidates, objective = find_candidates(coarse, evidence, readings, config)
        searched, traced = objective.evaluations, objective.renderer.rays
    local = LocalSearch(renderer, coarse, evidence, readings, config)
    modes = local.refine(candidates)
    best = modes[0]
    qualities, confirming = measure_quality(
        renderer, evidence, readings, modes, config.weights, decay=config.decay_px, field=config.distance_field
    )
    covariance = pose_covariance(modes, qualities[0])
    expected = expected_error(instrument, best.camera_from_root, best.joints, covariance)
    probability = mode_probability(modes, expected.of_tips_mm)
    reasons = judge(modes, qualities[0], expected, probability, evidence, readings, instrument, config.trust)
    return FoundPose(
        camera_from_root=best.camera_from_root,
        joints=best.joints,
        covariance=covariance,
        quality=qualities[0],
        reasons=tuple(reasons),
        evaluations=searched + local.silhouettes + renderer.poses,
        rays=traced + local.rays + renderer.rays + confirming,
        expected_error=expected,
        mode_probability=probability,
        alternatives=alternatives_of(instrument, readings, modes, qualities),
    )


def alternatives_of(
    instrument: Instrument, readings: Readings, modes: Sequence[OutlineFit], qualities: Sequence[Quality]
) -> tuple[Alternative, ...]:
    """Describe all modes of a frame but the first, with the qualities of all."""
    pairs = zip(modes[1:], qualities[1:], strict=True)
    return tuple(_alternative(instrument, readings, modes[0], mode, quality) for mode, quality in pairs)


def _alternative(
    instrument: Instrument, readings: Readings, best: OutlineFit, mode: OutlineFit, quality: Quality
) -> Alternative:
    """Describe another mode of the frame, and how it relates to the best one."""
    return Alternative(
        camera_from_root=mode.camera_from_root,
        joints=dict(zip(instrument.joint_names, mode.joints.tolist(), strict=True)),
        loss=quality.loss,
        iou=quality.iou,
        relation="mirror twin" if instrument.has_twin and is_twin(instrument, best, mode) else "other mode",
        reading_distance_deg=reading_distance(readings, mode.joints),
    )
