"""Measures of how well poses explain their frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.distance_field import distance_field
from dvrk_cmaes.evidence.gather import Evidence, shrunk, window_around
from dvrk_cmaes.evidence.outline_noise import distances_to
from dvrk_cmaes.evidence.quantiles import median, quantile
from dvrk_cmaes.evidence.steady_errors import steady_stretches
from dvrk_cmaes.evidence.straight_cut import largest_bend, shaft_width
from dvrk_cmaes.geometry import Bool, Float64, Posed
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search.objective import Terms, pose_terms
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.results.result import Quality
from dvrk_cmaes.silhouette.ray_check import trace_near_outlines

_BACK = 0.004  # m, from the root's origin to another point of its axis
_AROUND = 2  # px around a mask and silhouettes, so that the window has background
_FIELD = 160  # px, largest width and height of images of distances from a mask
_FARTHEST = 15.0  # px, to which distances of the contour beyond the shaft are limited


def _contour_distances(silhouette: Bool, points: Float64) -> Float64:
    """Compute signed distances, px, of points (N, 2) to a silhouette's outline, negative inside; inf without one."""
    if not len(points) or silhouette.all() or not silhouette.any():
        return np.full(len(points), np.inf)
    return distances_to(silhouette, points)


def _distal_error(evidence: Evidence, pose: Float64, signed: Float64) -> float:
    """Compute the root mean square of the contour's distances (N,), px, beyond the root's origin of a pose (4, 4).

    Distances are limited to ``_FARTHEST`` px. Returns 0 if no contour lies beyond it or it is behind the camera.
    """
    ends = pose[:3, 3] + np.array([[0.0], [-_BACK]]) * pose[:3, 2]
    if not len(signed) or (ends[:, 2] <= 0).any():
        return 0.0
    origin, back = evidence.camera.project(ends)
    distal = (evidence.contour.pixels - origin) @ (origin - back) > 0
    if not distal.any():
        return 0.0
    return float(np.sqrt(np.mean(np.minimum(np.abs(signed[distal]), _FARTHEST) ** 2)))


def measure_views(
    views: Sequence[FrameView], readings: Readings, at: Posed, config: EstimateConfig, *, traced: int | None = None
) -> tuple[list[list[Quality]], int]:
    """Measure overlap, losses and contour distances of C poses in each view at full image size.

    The silhouettes are rendered as masks; the first ``traced`` of each view, all by default, are checked by ray tracing
    along their outlines. The distance field is computed in a window around the mask and all silhouettes. The readings
    count in every view, so that the mean of the losses has them once. Returns a list of the poses' qualities for each
    view, and the number of rays traced.
    """
    of_views, rays = [], 0
    for view in views:
        seen = at.seen_from(view.view_from_camera)
        masks, first = view.renderer.masks(seen.pose, seen.joints), slice(traced)
        masks[first], count = trace_near_outlines(view.renderer, seen.pose[first], seen.joints[first], masks[first])
        terms = _losses(view, readings, seen, masks, config)
        qualities = enumerate(_without_losses(view, seen, masks))
        of_views.append([_with_losses(quality, terms, k, config) for k, quality in qualities])
        rays += count
    return of_views, rays


def _with_losses(quality: Quality, terms: Terms, k: int, config: EstimateConfig) -> Quality:
    """Return the quality of the k-th pose with its terms of the loss."""
    by_name = {name: float(value[k]) for name, value in vars(terms).items()}
    return replace(quality, loss=float(terms.total(config.weights)[k]), terms=by_name)


def measure_overlap(view: FrameView, at: Posed) -> Quality:
    """Measure overlap and contour distances of one pose in one view, without the losses of a search.

    The silhouette is as rendered, without rays along its outline; loss and terms are 0 and none.
    """
    seen = at.seen_from(view.view_from_camera)
    return _without_losses(view, Posed.stacked([seen]), view.silhouette(at)[None])[0]


def _losses(view: FrameView, readings: Readings, seen: Posed, masks: Bool, config: EstimateConfig) -> Terms:
    """Return the terms of the loss of C poses in a view's camera, whose silhouettes are ``masks`` (C, H, W)."""
    evidence = view.evidence
    window = _window(evidence, masks)
    mask, weight = evidence.mask[window], evidence.weight[window]
    drawn = masks[:, window[0], window[1]]
    far = _far(mask, np.logical_or.reduce(drawn), config.distance_field) / config.decay_px
    area = float(weight[mask].sum(dtype=np.float64))
    sums = []
    for silhouette in drawn:
        if evidence.ignores:
            shown = silhouette * weight
            covered = [part.sum(dtype=np.float64) for part in (shown, shown[mask])]
            beyond = np.where(mask, np.float32(0), shown)
        else:
            covered = [np.float64(np.count_nonzero(part)) for part in (silhouette, silhouette & mask)]
            beyond = (silhouette & ~mask).astype(np.float32)
        outside = shrunk(beyond, far.shape[1], far.shape[0])
        away = np.vdot(outside, far) * (mask.size / far.size)
        sums.append([*covered, away])
    of_pose = pose_terms(evidence, view.renderer.body.instrument, readings, config.weights, seen)
    return Terms.of(np.array(sums), area, area, of_pose)


def _far(mask: Bool, where: Bool, method: str) -> Float64:
    """Compute the distance field, px, of a mask in a window, of which only the pixels ``where`` are needed.

    It is that of a smaller image where the window is large: distances vary slowly.
    """
    by = -(-max(mask.shape) // _FIELD)
    width, height = max(mask.shape[1] // by, 1), max(mask.shape[0] // by, 1)
    share, needed = (shrunk(each.astype(np.float32), width, height) for each in (mask, where))
    inside = share > min(0.5, 0.99 * float(share.max()))
    # the distance field is undefined for a mask without background
    field = distance_field(np.pad(inside, 1), method, where=np.pad(needed > 0, 1))
    return np.asarray(field[1:-1, 1:-1] * np.sqrt(mask.size / (width * height)))


def _window(evidence: Evidence, masks: Bool) -> tuple[slice, slice]:
    """Return the rows and columns of the window around a mask and silhouettes (C, H, W)."""
    whole = evidence.mask.shape
    low, high = np.array(whole), np.zeros(2, dtype=np.intp)
    for mask in (evidence.mask, *masks):
        left, top, width, height = window_around(mask, 0)
        if width:
            low, high = np.minimum(low, [top, left]), np.maximum(high, [top + height, left + width])
    low, high = np.maximum(low - _AROUND, 0), np.minimum(high + _AROUND, whole)
    return np.s_[low[0] : high[0], low[1] : high[1]]


def _without_losses(view: FrameView, seen: Posed, masks: Bool) -> list[Quality]:
    """Measure C poses in a view's camera, whose silhouettes are ``masks`` (C, H, W), but for their losses."""
    evidence, renderer = view.evidence, view.renderer
    window = _window(evidence, masks)
    top, left = window[0].start, window[1].start
    qualities = []
    for i, silhouette in enumerate(masks[:, window[0], window[1]]):
        # infinite for a silhouette outside the image: limited to the diagonal of the image
        diagonal = float(np.hypot(*evidence.mask.shape))
        signed = np.clip(_contour_distances(silhouette, evidence.contour.pixels - [left, top]), -diagonal, diagonal)
        distances = np.abs(signed) if len(signed) else np.array([diagonal])
        shaft = shaft_width(renderer.body.instrument, evidence.camera, seen.pose[i])
        qualities.append(
            Quality(
                iou=evidence.overlap_with(masks[i], window),
                loss=0.0,
                terms={},
                contour_px_median=median(distances),
                contour_px_95=quantile(distances, 0.95),
                bend_px=0.0 if shaft is None else largest_bend(evidence.contour.pixels, signed, shaft),
                steady_share=float(steady_stretches(evidence.contour.pixels, signed).mean()) if len(signed) else 0.0,
                distal_px=_distal_error(evidence, seen.pose[i], signed),
            )
        )
    return qualities


def pooled_quality(qualities: Sequence[Quality]) -> Quality:
    """Return the quality of a pose in several views: means, and the largest of what tells a cut or occluded mask."""
    names = ("iou", "loss", "contour_px_median", "steady_share")
    means = {name: float(np.mean([getattr(quality, name) for quality in qualities])) for name in names}
    largest = {name: max(getattr(quality, name) for quality in qualities) for name in ("contour_px_95", "bend_px")}
    terms = {name: float(np.mean([quality.terms[name] for quality in qualities])) for name in qualities[0].terms}
    distal = float(np.sqrt(np.mean([quality.distal_px**2 for quality in qualities])))
    return Quality(**{**asdict(qualities[0]), **means, **largest, "terms": terms, "distal_px": distal})
