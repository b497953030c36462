"""Features of an estimate that may separate right poses from wrong ones; the trust thresholds are chosen from them.

All of them are computed from the frame and its result, without the truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence, gather_evidence
from dvrk_cmaes.evidence.outline_noise import measure_noise, sampled, signed_distance
from dvrk_cmaes.geometry import Posed, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body, Renderer

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

_NO_MODE = 1e3  # gap to a mode that was not found


def measure_features(
    result: Result, mask: Bool, camera: Camera, body: Body, config: EstimateConfig, *, ignore: Bool | None = None
) -> dict[str, float]:
    """Compute the features of a result, by name.

    Distances are in px of the full image, shares are relative to the mask's area. A gap is the difference in score
    between the best other mode of a relation and the result: of outline and readings, of the ``_outline`` alone, of the
    overlap (``_iou``), and the ratio of the outline's ``_residual``. ``z_*`` are distances from the readings in
    standard deviations of the readings; ``std_*`` are standard deviations of the joints relative to these. Features
    that cannot be computed are left out.
    """
    assert result.quality is not None
    assert result.camera_from_root is not None
    instrument = body.instrument
    names = instrument.joint_names
    evidence = gather_evidence(mask, camera, instrument, ignore=ignore, seed=config.seed)
    sigma = np.deg2rad([config.readings.of(name) for name in names])
    values = np.array([result.readings.get(name, np.nan) for name in names])
    joints = np.array([result.joints[name] for name in names])
    renderer = Renderer(body, camera, threads=1)
    silhouette = renderer.masks(result.camera_from_root[None], joints[None])[0]
    quality = result.quality
    features = {
        "iou": quality.iou,
        "contour_px_median": quality.contour_px_median,
        "contour_px_95": quality.contour_px_95,
        "bend_px": quality.bend_px,
        **{f"term_{name}": value for name, value in quality.terms.items()},
    }
    for name, z in zip(names, (joints - values) / sigma, strict=True):
        features[f"z_{name}"] = float(z)
    features["z_rms"] = float(np.sqrt(np.nansum(((joints - values) / sigma) ** 2) / len(names)))
    assert result.covariance is not None
    for k, name in enumerate(names):
        features[f"std_{name}"] = float(np.sqrt(result.covariance[6 + k, 6 + k]) / sigma[k])
    features |= _modes(result, evidence, renderer, Readings(values, sigma, *_limits(instrument)), config, silhouette)
    features |= _overlap(mask & evidence.weight.astype(np.bool_), silhouette, evidence)
    features |= _edges(evidence)
    features["depth_m"] = float(result.camera_from_root[2, 3])
    tips = apply(result.camera_from_root, instrument.tips(joints))
    if len(tips) and tips[:, 2].min() > 1e-3:
        pixels = camera.project(tips)
        size = np.array([camera.width, camera.height])
        features["tip_margin_px"] = float(np.minimum(pixels, size - 1 - pixels).min())
    return {name: float(value) for name, value in features.items() if np.isfinite(value)}


def _limits(instrument: Instrument) -> tuple[Float64, Float64]:
    """Return the lower and upper limits (J,) of the joints, rad; the jaw's lower limit is 0."""
    low, high = instrument.limits.T.copy()
    if "jaw" in instrument.joint_names:
        low[instrument.joint_index("jaw")] = 0.0
    return low, high


def _modes(
    result: Result,
    evidence: Evidence,
    renderer: Renderer,
    readings: Readings,
    config: EstimateConfig,
    silhouette: Bool,
) -> dict[str, float]:
    """Compute the noise and the residual of the outline, and the gaps to the other modes."""
    assert result.camera_from_root is not None
    noise = measure_noise(evidence.contour, silhouette)
    outline = replace(config.refine.outline, correlation=noise.length)
    view = FrameView("", evidence, renderer, np.eye(4))
    coverage = Coverage([SizedView(view, blur=outline.blur)], outline)

    def residual_and_score(pose: Float64, joints: Mapping[str, float]) -> tuple[float, float, float]:
        """Return the residual of a pose, its negative log-likelihood, and the part of that by the readings."""
        at = Posed(pose, np.array(list(joints.values())))
        (drawn,), prior = coverage.draw(at[None], derivatives=False), 0.5 * float(readings.cost(at.joints))
        return coverage.cost_of(drawn), coverage.score_of(drawn) + prior, prior

    best_residual, best_score, best_prior = residual_and_score(result.camera_from_root, result.joints)
    features = {
        "noise_sigma_px": noise.sigma,
        "noise_length_px": noise.length,
        "residual_per_px": best_residual / max(len(evidence.contour.pixels), 1),
        "gap_twin": _NO_MODE,
        "gap_other": _NO_MODE,
    }
    for other in result.alternatives:
        residual, score, prior = residual_and_score(other.camera_from_root, other.joints)
        name = "gap_twin" if other.relation == "mirror twin" else "gap_other"
        gap = score - best_score
        if gap < features[name]:
            features[name] = gap
            features[f"{name}_outline"] = gap - prior + best_prior
            features[f"{name}_residual"] = residual / best_residual
            features[f"{name}_iou"] = result.quality.iou - other.iou if result.quality is not None else np.nan
    return features


def _overlap(mask: Bool, silhouette: Bool, evidence: Evidence) -> dict[str, float]:
    """Compute area, thickness and distances of the differences between mask and silhouette."""
    counts = evidence.weight > 0
    drawn = silhouette & counts
    area = max(int(mask.sum()), 1)
    missed, extra = mask & ~drawn, drawn & ~mask
    count, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    areas = np.sort(stats[1:, cv2.CC_STAT_AREA])[::-1] if count > 1 else np.zeros(1)
    return {
        "mask_area_px": float(area),
        "contour_length_px": float(len(evidence.contour.pixels)),
        "missed_share": float(missed.sum() / area),
        "extra_share": float(extra.sum() / area),
        "missed_depth_px": _thickest(missed),
        "extra_depth_px": _thickest(extra),
        "missed_blob_share": _largest_blob(missed) / area,
        "extra_blob_share": _largest_blob(extra) / area,
        "largest_part_share": float(areas[0] / area),
        **{f"from_mask_px_{p}": v for p, v in _percentiles(silhouette, mask, counts).items()},
        **{f"from_silhouette_px_{p}": v for p, v in _percentiles(mask, silhouette, counts).items()},
    }


def _thickest(region: Bool) -> float:
    """Return half the largest width of a region, px."""
    if not region.any():
        return 0.0
    padded = np.pad(region.astype(np.uint8), 1)
    return float(cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE).max())


def _largest_blob(region: Bool) -> float:
    """Return the area, px, of the largest component of a region after a morphological opening with 5 x 5 pixels."""
    opened = cv2.morphologyEx(region.astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
    count, _, stats, _ = cv2.connectedComponentsWithStats(opened)
    return float(stats[1:, cv2.CC_STAT_AREA].max()) if count > 1 else 0.0


def _percentiles(reference: Bool, other: Bool, counts: Bool, at: Sequence[int] = (50, 80, 95, 99)) -> dict[int, float]:
    """Return percentiles of the distances, px, of the outline of a mask from that of a reference."""
    found, _ = cv2.findContours(other.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not found or reference.all() or not reference.any():
        return dict.fromkeys(at, float(np.hypot(*reference.shape)))
    points = np.concatenate(found)[:, 0].astype(np.float64)
    height, width = reference.shape
    inner = (points > 2).all(axis=1) & (points < [width - 3, height - 3]).all(axis=1)
    points = points[inner & counts[points[:, 1].astype(int), points[:, 0].astype(int)]]
    if not len(points):
        return dict.fromkeys(at, 0.0)
    distance = np.abs(sampled(signed_distance(reference), points))
    return {p: float(np.percentile(distance, p)) for p in at}


def _edges(evidence: Evidence) -> dict[str, float]:
    """Return the number of pairs of shaft edges, and the best pair's standard deviation, px, and number of points."""
    pairs = evidence.shaft_edges
    return {
        "edge_pairs": float(len(pairs)),
        "edge_sigma_px": float(pairs[0].sigma.max()) if pairs else np.nan,
        "edge_support": float(pairs[0].support.min()) if pairs else 0.0,
    }
