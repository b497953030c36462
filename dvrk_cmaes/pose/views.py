"""The views of one frame that show the instrument, and the evidence in each.

Thin things that the jaws hold, such as a suture needle or a thread, in a mask: they count neither way.

Measures of how well poses explain their frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.camera import View
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence, gather_evidence, shrunk, window_around
from dvrk_cmaes.evidence.jaw_tips import largest_bend, shaft_width
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, distance_field, distances_to, measure_noise
from dvrk_cmaes.evidence.quantiles import median, quantile, steady_stretches
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.geometry import Bool, Float64, Posed
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search.objective import Terms, pose_terms
from dvrk_cmaes.results.result import Quality
from dvrk_cmaes.silhouette import Body, Renderer


@dataclass(frozen=True, eq=False)
class FrameView:
    """One view of a frame: its name, evidence, renderer at full detail, and ``view_from_camera`` (4, 4), m."""

    name: str
    evidence: Evidence
    renderer: Renderer
    view_from_camera: Float64

    @classmethod
    def of(
        cls,
        seen: SeenView,
        body: Body,
        ignore: Bool | None,
        keypoints: Float64 | None = None,
        *,
        seed: int = 0,
        features: bool = True,
        threads: int = 1,
    ) -> FrameView:
        """Gather the evidence of a view, as `gather_evidence`, and make its renderer with some ``threads``."""
        shown = seen.mask, seen.camera, body.instrument
        evidence = gather_evidence(*shown, ignore=ignore, keypoints=keypoints, seed=seed, features=features)
        return cls(seen.name, evidence, Renderer(body, evidence.camera, threads=threads), seen.view_from_camera)

    def silhouette(self, at: Posed) -> Bool:
        """Draw the silhouette (H, W) of one pose in the reference camera."""
        seen = at.seen_from(self.view_from_camera)
        return np.asarray(self.renderer.masks(seen.pose[None], seen.joints[None])[0])

    def noise_at(self, at: Posed) -> OutlineNoise:
        """Estimate the noise of the mask's contour from its distances to the silhouette of one pose."""
        return measure_noise(self.evidence.contour, self.silhouette(at))


def clearest_view(views: Sequence[FrameView]) -> FrameView:
    """Return the view with the largest mask, in solid angle; the first of equals."""

    def seen(view: FrameView) -> float:
        camera, evidence = view.evidence.camera, view.evidence
        return float((evidence.mask * evidence.weight).sum()) / (camera.fx * camera.fy)

    return max(views, key=seen)


def overlap(views: Sequence[FrameView], drawn: Sequence[Bool]) -> float:
    """Return the mean intersection over union of silhouettes and masks, one a view, without ignored pixels."""
    shares = [view.evidence.overlap_with(seen) for view, seen in zip(views, drawn, strict=True)]
    return float(np.mean(shares))


def silhouette_of(at: Posed, view: View, body: Body) -> Bool:
    """Return the silhouette (H, W) in a view of an instrument that is given in the reference camera."""
    seen = at.seen_from(view.view_from_camera)
    return np.asarray(Renderer(body, view.camera, threads=1).masks(seen.pose[None], seen.joints[None])[0])


HELD: Final = "something thin is held in the jaws: its pixels do not count"
"""The remark on a frame in which it was found."""

_THICK: Final = 0.2  # of the shaft's width: a thing that is thicker anywhere is none of these
_REACH: Final = 0.3  # of the shaft's width, that one reaches beyond the silhouette at least
_COVERED: Final = 0.97  # least share of the silhouette that the mask covers: the rest of it fits
_NEAR_PX: Final = 2  # of the silhouette, where its own outline lies


def without(view: SeenView, held: Bool | None) -> SeenView:
    """Return a view whose pixels (H, W) of what is held are ignored."""
    if held is None:
        return view
    return replace(view, ignore=held if view.ignore is None else view.ignore | held)


def held_in(view: FrameView, at: Posed) -> Bool | None:
    """Return the pixels (H, W) of thin things that reach out of a pose's silhouette in a view; None without any."""
    seen, evidence = at.seen_from(view.view_from_camera), view.evidence
    width = shaft_width(view.renderer.body.instrument, evidence.camera, seen.pose)
    silhouette = view.silhouette(at)
    shown = silhouette & (evidence.weight > 0)
    if width is None or not shown.any() or (shown & evidence.mask).sum() < _COVERED * shown.sum():
        return None
    away = cv2.distanceTransform((~silhouette).astype(np.uint8), cv2.DIST_L2, 5)
    if not (evidence.mask & (away > _REACH * width)).any():
        return None
    beyond = (evidence.mask & (away > _NEAR_PX)).astype(np.uint8)
    thickness = 2 * cv2.distanceTransform(beyond, cv2.DIST_L2, 5)
    parts = np.asarray(cv2.connectedComponents(beyond, connectivity=8)[1], np.intp)
    inside, largest = parts > 0, np.zeros((2, int(parts.max()) + 1))
    for own, of_part in zip((thickness, away), largest, strict=True):
        np.maximum.at(of_part, parts[inside], np.asarray(own[inside], np.float64))
    held = ((largest[0] < _THICK * width) & (largest[1] > _REACH * width))[parts]
    if not held.any():
        return None
    around = cv2.dilate(held.astype(np.uint8), np.ones((2 * _NEAR_PX + 3,) * 2, np.uint8)) > 0
    return np.asarray(around & ~silhouette)


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
    """Return the quality of a pose in several views: means, and the largest of what a cut or occluded mask has."""
    names = ("iou", "loss", "contour_px_median", "steady_share")
    means = {name: float(np.mean([getattr(quality, name) for quality in qualities])) for name in names}
    largest = {name: max(getattr(quality, name) for quality in qualities) for name in ("contour_px_95", "bend_px")}
    terms = {name: float(np.mean([quality.terms[name] for quality in qualities])) for name in qualities[0].terms}
    distal = float(np.sqrt(np.mean([quality.distal_px**2 for quality in qualities])))
    return Quality(**{**asdict(qualities[0]), **means, **largest, "terms": terms, "distal_px": distal})


def trace_near_outlines(
    renderer: Renderer, camera_from_root: Float64, joints: Float64, masks: Bool
) -> tuple[Bool, int]:
    """Retrace the pixels on both sides of the outlines of C masks, (C, H, W).

    Coverage from spans and from rays are computed independently of each other, from the same meshes. They can differ
    only next to the outline. Returns the masks with the traced values and the number of rays.
    """
    result = masks.copy()
    links = renderer.body.camera_from_links(camera_from_root, joints)
    rays = 0
    for i, mask in enumerate(masks):
        band = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
        row, column = np.nonzero(band)
        pixels = np.stack([column, row], axis=1).astype(np.float64)
        directions = np.c_[renderer.camera.normalise(pixels), np.ones(len(pixels))]
        one = np.zeros(len(pixels), dtype=np.intp)
        result[i, row, column] = renderer.body.scenes.covered(links[i : i + 1], one, directions)
        rays += len(pixels)
    return result, rays
