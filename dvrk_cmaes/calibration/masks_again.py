"""Masks of a session that are found in its images once more, around the silhouettes that the session expects.

The session is then solved again. Whether that is better is measured against the first masks, from which nothing that is
expected of a frame has been drawn: if the frames predict each other's first masks worse, the first solution is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.calibration.stored_frame import StoredFrame, changed, restored_views
from dvrk_cmaes.camera import View
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.frames.seen_view import PackedMask, overlap_of
from dvrk_cmaes.geometry import Bool, Float64, Posed, change_between
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Count, Number
from dvrk_cmaes.pose.quality import measure_overlap, pooled_quality
from dvrk_cmaes.pose.views import silhouette_of
from dvrk_cmaes.silhouette import Body

FindMasks = Callable[[Mapping[str, Bool], Mapping[str, Bool]], Mapping[str, Bool]]
"""Finds masks (H, W) in the images of a frame, by view, around silhouettes, given the first masks; picklable."""

_UNCHANGED = 0.999  # intersection over union of both masks of a view, from which on the first one is kept
_WORSE = 5e-4, 0.02  # overlap and px at 640 px of width, by which the predictions of the first masks may become worse


@dataclass(frozen=True)
class MasksAgain(Document):
    """What changed as the masks of a session were found again around its silhouettes.

    frames : number of frames whose masks were found again, changed : of those whose masks changed. iou : mean overlap
    of both masks. base_mm, base_deg : move of the base. before, after : mean overlap, and median contour distance, px,
    of the first masks and the silhouettes that the other frames predict, by both solutions. applied : whether the new
    masks and their solution are used.
    """

    frames: Count
    changed: Count
    iou: Number
    base_mm: Number
    base_deg: Number
    iou_before: Number
    iou_after: Number
    contour_px_before: Number
    contour_px_after: Number
    applied: bool

    def describe(self) -> str:
        """Describe in words what changed, and what is used."""
        done = "used" if self.applied else "not used, since the first masks are predicted worse"
        if not self.changed:
            done = "all as they were"
        return (
            f"masks found again around the silhouettes that the session expects: {self.changed} of {self.frames} "
            f"frames changed (mean IoU {self.iou:.4f} with the first masks), base moved by {self.base_mm:.2f} mm, "
            f"{self.base_deg:.2f} deg; first masks predicted by the other frames: IoU {self.iou_before:.4f}, then "
            f"{self.iou_after:.4f}, contour {self.contour_px_before:.2f}, then {self.contour_px_after:.2f} px median; "
            f"{done}"
        )


def compared(
    overlaps: Sequence[float],
    changed_frames: int,
    bases: tuple[Float64, Float64],
    predicted: Sequence[tuple[tuple[float, float], tuple[float, float]]],
    px_scale: float,
) -> MasksAgain:
    """Compare two solutions of a session, the second one of masks that were found again, and choose one.

    Parameters
    ----------
    overlaps
        Intersection over union of both masks, of each frame whose masks were found again.
    changed_frames
        Number of frames whose masks changed.
    bases
        camera_from_base (4, 4), m, of both solutions.
    predicted
        Of each frame, by both solutions, the overlap of its first mask and the silhouette that the other frames
        predict, and the median distance of their contours, px.
    px_scale
        Factor on limits in pixels, which grow with wider images.
    """
    both = np.array(predicted).reshape(-1, 2, 2)
    iou, contour = both[..., 0].mean(axis=0), np.median(both[..., 1], axis=0)
    moved = change_between(*bases)
    worse = iou[1] < iou[0] - _WORSE[0] or contour[1] > contour[0] + px_scale * _WORSE[1]
    base = 1e3 * float(np.linalg.norm(moved[:3])), float(np.degrees(np.linalg.norm(moved[3:])))
    pairs = float(iou[0]), float(iou[1]), float(contour[0]), float(contour[1])
    applied = changed_frames > 0 and not worse
    return MasksAgain(len(overlaps), changed_frames, float(np.mean(overlaps)), *base, *pairs, applied)


@dataclass(frozen=True)
class FoundAgain:
    """The masks of a frame by view that changed, and the least overlap of both masks over the views."""

    masks: dict[str, PackedMask]
    iou: float


def again_task(
    body: Body,
    config: EstimateConfig,
    task: tuple[FrameData | Callable[[], FrameData], FindMasks, Posed, bool, Float64 | None],
) -> FoundAgain:
    """Find the masks of one frame again, given its data, what finds its masks, and where the instrument is.

    Then comes whether that must be near the first masks: it need not where the frame disagrees with its session. Last
    comes the change (3,) of all cameras, as of `changed`, where they are not those of the data.
    """
    given_data, find, at, near, change = task
    data = read_data(given_data)
    given = [view for view in data.views if view.given]
    width, silhouettes = data.camera.width, {}
    for view in given:
        camera = view.camera if change is None else changed(view.camera, change, width)
        silhouettes[view.name] = silhouette_of(at, View(view.name, camera, view.view_from_camera), body)
    first = {view.name: view.mask for view in given}
    found = find(silhouettes, first if near else {})
    overlaps = {name: overlap_of(mask, first[name]) for name, mask in found.items()}
    masks = {name: PackedMask.of(mask) for name, mask in found.items() if overlaps[name] < _UNCHANGED}
    return FoundAgain(masks, min(overlaps.values(), default=1.0))


def predicted_task(
    body: Body, config: EstimateConfig, task: tuple[StoredFrame, Sequence[Posed], Float64 | None]
) -> list[tuple[float, float]]:
    """Measure the overlap of a frame's mask and the silhouette at each pose, and the median contour distance, px.

    The task is the evidence of the frame, the poses, and the change of its cameras, if any.
    """
    stored, poses, change = task
    views = restored_views(body, stored, change)
    pooled = (pooled_quality([measure_overlap(view, at) for view in views]) for at in poses)
    return [(quality.iou, quality.contour_px_median) for quality in pooled]


def with_masks(masks: Mapping[str, PackedMask], data: FrameData) -> FrameData:
    """Return data of a frame with other masks of some views."""
    views = (replace(v, mask=masks[v.name].restored()) if v.name in masks else v for v in data.views)
    return replace(data, views=tuple(views))


def read_data(data: FrameData | Callable[[], FrameData]) -> FrameData:
    """Return the data of a frame, or what the function that reads them returns."""
    return data if isinstance(data, FrameData) else data()
