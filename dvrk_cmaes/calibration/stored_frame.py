"""Evidence of a session's frames, small enough to be stored for all of them and sent to processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.calibration.frame_fit import OwnEstimate, with_noise
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence, gather_evidence
from dvrk_cmaes.evidence.shadows import shadow_stretches
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.frames.seen_view import PackedMask, shown_views
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.pose.views import FrameView, held_in
from dvrk_cmaes.silhouette import Body, Renderer


@dataclass(frozen=True, eq=False)
class StoredView:
    """One view of a frame with one bit a pixel, small enough to be stored for all frames and sent to processes.

    ``name``, ``evidence`` and ``view_from_camera`` (4, 4), m, are those of the view, without the images ``mask`` and
    ``weight`` of the evidence, which are (0, 0). ``counts`` says which pixels have weight 1, None where all have.
    """

    name: str
    evidence: Evidence
    mask: PackedMask
    counts: PackedMask | None
    view_from_camera: Float64

    @classmethod
    def of(cls, view: FrameView) -> StoredView:
        """Pack a view whose weights are 0 or 1."""
        evidence, empty = view.evidence, np.empty((0, 0), np.float32)
        counts = None if evidence.weight.all() else PackedMask.of(evidence.weight > 0)
        small = replace(evidence, mask=empty > 0, weight=empty)
        return cls(view.name, small, PackedMask.of(evidence.mask), counts, view.view_from_camera)

    def restored(self, body: Body, camera: Camera | None = None, place: Float64 | None = None) -> FrameView:
        """Return the view with its images and a renderer; with another camera or ``place`` (4, 4), m, if given."""
        mask = self.mask.restored()
        counts = np.ones_like(mask) if self.counts is None else self.counts.restored()
        camera = self.evidence.camera if camera is None else camera
        evidence = replace(self.evidence, mask=mask, weight=counts.astype(np.float32), camera=camera)
        place = self.view_from_camera if place is None else place
        return FrameView(self.name, evidence, Renderer(body, camera, threads=1), place)


@dataclass(frozen=True, eq=False)
class StoredFrame:
    """A frame's views that show the instrument, in the order of the rig; ``camera`` is the reference camera.

    ``own`` is the frame's own estimate.
    """

    views: tuple[StoredView, ...]
    camera: Camera
    own: OwnEstimate

    @classmethod
    def of(
        cls,
        data: FrameData,
        own: Posed,
        body: Body,
        config: EstimateConfig,
        keypoints: Float64 | None = None,
        *,
        features: bool = True,
    ) -> StoredFrame:
        """Gather the evidence of a frame's views, and measure the frame's own estimate in them.

        ``keypoints`` (2, 2) px are the jaw tips in the first view; ``features`` is as in `gather_evidence`. Stretches
        of a mask's contour that are no edge of the view's image, if there is one, do not count.

        Raises
        ------
        InputError
            As `gather_evidence`: no view shows the instrument.
        """
        views = []
        for view in shown_views(data.views):
            tips = keypoints if view is data.views[0] else None
            shadows = None if view.image is None else shadow_stretches(view.image, view.mask)
            hidden = [part for part in (view.ignore, shadows) if part is not None]
            evidence = gather_evidence(
                view.mask,
                view.camera,
                body.instrument,
                ignore=np.logical_or.reduce(hidden) if hidden else None,
                keypoints=tips,
                seed=config.seed,
                features=features,
            )
            renderer = Renderer(body, evidence.camera, threads=1)
            one = FrameView(view.name, evidence, renderer, view.view_from_camera)
            if features and view.ignore is None and (held := held_in(one, own)) is not None:
                free = gather_evidence(
                    view.mask, view.camera, body.instrument, ignore=held, keypoints=tips, seed=config.seed
                )
                one = replace(one, evidence=free)
            views.append(one)
        return cls.of_views(views, data.camera, with_noise(OwnEstimate.of(views, own), views, config))

    @classmethod
    def of_views(cls, views: Sequence[FrameView], camera: Camera, own: OwnEstimate) -> StoredFrame:
        """Pack the views of a frame that show the instrument."""
        return cls(tuple(map(StoredView.of, views)), camera, own)

    def number_of(self, view: str) -> int | None:
        """Return the number of the view of that name; None if it does not show the instrument."""
        return next((k for k, one in enumerate(self.views) if one.name == view), None)

    @property
    def in_reference(self) -> bool:
        """Whether the reference camera shows the instrument."""
        return bool(np.array_equal(self.views[0].view_from_camera, np.eye(4)))


def camera_remarks(stored: StoredFrame) -> tuple[str, ...]:
    """Return what is unusual about the camera files of a frame."""
    further = [view for view in stored.views if not np.array_equal(view.view_from_camera, np.eye(4))]
    of_views = (f"view {view.name}: {text}" for view in further for text in view.evidence.camera.remarks)
    return (*stored.camera.remarks, *of_views)


def changed(camera: Camera, change: Float64, width: int | None = None) -> Camera:
    """Return a camera after a change (3,): the logarithm of the focal length's factor, and the shift of the centre, px.

    The shift is in images of ``width`` px, by default the camera's own. InputError as `Camera.changed`.
    """
    size = 1.0 if width is None else camera.width / width
    return camera.changed(float(np.exp(change[0])), (size * float(change[1]), size * float(change[2])))


def restored_views(body: Body, stored: StoredFrame, change: Float64 | None = None) -> list[FrameView]:
    """Restore the evidence of a frame's views, and make their renderers, with changed cameras if there is a change."""
    if change is None:
        return [view.restored(body) for view in stored.views]
    return [view.restored(body, changed(view.evidence.camera, change, stored.camera.width)) for view in stored.views]
