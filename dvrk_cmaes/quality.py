"""How well a pose explains its frame, and whether it can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.evidence import Evidence
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.local_search import is_twin
from dvrk_cmaes.objective import Objective, Readings
from dvrk_cmaes.refine.outline import OutlineFit
from dvrk_cmaes.result import Quality

Float64 = NDArray[np.float64]


def _contour_distances(silhouette: NDArray[np.bool_], evidence: Evidence) -> Float64:
    """Distances in px from the mask's contour points to the silhouette's outline, (N,)."""
    outline = cv2.morphologyEx(silhouette.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    points = evidence.contour.pixels
    if not outline.any() or not len(points):
        return np.full(max(len(points), 1), np.inf)
    # The gradient is two pixels wide, one on each side of the outline.
    distance = cv2.distanceTransform(1 - outline, cv2.DIST_L2, 5)
    column, row = np.rint(points).astype(int).T
    return np.asarray(distance[row, column], dtype=np.float64)


def measure_quality(objective: Objective, mode: OutlineFit) -> Quality:
    """Overlap, losses and contour distances of one pose at full size."""
    evidence = objective.evidence
    pose, joints = mode.camera_from_root[None], mode.joints[None]
    silhouette = objective.renderer.masks(pose, joints)[0]
    counted = evidence.weight > 0.5
    both = (silhouette & evidence.mask & counted).sum()
    either = ((silhouette | evidence.mask) & counted).sum()
    terms = objective.terms(pose, joints)
    distances = _contour_distances(silhouette, evidence)
    far = float(np.hypot(*silhouette.shape))
    return Quality(
        iou=float(both / max(either, 1)),
        loss=float(terms.total(objective.weights)[0]),
        terms={name: float(value[0]) for name, value in asdict(terms).items()},
        contour_px_median=float(np.minimum(np.median(distances), far)),
        contour_px_95=float(np.minimum(np.percentile(distances, 95), far)),
    )


def judge(
    best: OutlineFit,
    modes: Sequence[OutlineFit],
    quality: Quality,
    evidence: Evidence,
    readings: Readings,
    instrument: Instrument,
    trust: TrustConfig,
) -> list[str]:
    """Reasons to doubt a pose, in words; none where it can be trusted."""
    reasons = []
    if quality.iou < trust.least_iou:
        reasons.append(f"overlap too low: IoU {quality.iou:.3f}, expected at least {trust.least_iou:.2f}")
    if quality.contour_px_95 > trust.largest_contour_px:
        reasons.append(
            f"outline residual too high: a twentieth of the mask's contour is more than "
            f"{quality.contour_px_95:.1f} px from the silhouette"
        )
    known = ~np.isnan(readings.values)
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
    off = np.abs(best.joints - readings.values) / readings.spread
    for name, sigmas in zip(instrument.joint_names, off, strict=True):
        if sigmas > trust.largest_reading_sigmas:
            reasons.append(f"far from the readings: {name} is {sigmas:.1f} times the expected error away")
    if instrument.shaft is not None and not evidence.shaft_edges:
        reasons.append("shaft not found: no two edges in the mask could bound it")
    return reasons
