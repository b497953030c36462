"""The frames of a session: their evidence, stored for all of them, and tasks on one frame, which any process can do."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Self, TypeVar

import numpy as np

from dvrk_cmaes.calibration.blocks import SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.frame_fit import FitPreset, FrameFit, OwnEstimate, fit_frame, with_noise
from dvrk_cmaes.calibration.model import outer_readings
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.rig import turned_views
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.shadows import shadow_stretches
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.frames.seen_view import PackedMask, shown_views
from dvrk_cmaes.geometry import Float64, Posed, change_between
from dvrk_cmaes.joints.prior import Readings, reading_distance, split_readings
from dvrk_cmaes.pose.expected_error import (
    covariance_by_camera,
    expected_error,
    locate_tips,
    rough_covariance,
    tip_probability,
)
from dvrk_cmaes.pose.judge import doubts_in_views, jaw_end_missing
from dvrk_cmaes.pose.search.starts import are_distinct
from dvrk_cmaes.pose.terms.tips_term import Expected
from dvrk_cmaes.pose.views import FrameView, held_in, measure_overlap, measure_views, pooled_quality
from dvrk_cmaes.results.parts import posed
from dvrk_cmaes.results.result import Alternative, Quality, Result
from dvrk_cmaes.silhouette import Body, Renderer

T = TypeVar("T")
R = TypeVar("R")

NOT_READ: Final = "no readings of all outer joints (yaw, pitch, insertion, roll)"
"""Why a frame cannot be solved with others."""

SeenAs = tuple[tuple[SeenBlock, Float64], ...]
"""Blocks that change what the views show, each with its values (n,)."""

Run = Callable[[Callable[[Body, EstimateConfig, T], R], Sequence[T]], list[R]]
"""Applies a function of body, settings and task to all tasks, and returns the values in the tasks' order."""


@dataclass(frozen=True, eq=False)
class SessionFrame:
    """A frame of a session.

    ``data`` are its data or a function that reads them, picklable where several processes are used. ``result`` is its
    own result, estimated without the session. ``keypoints`` (2, 2), px, are the jaw tips; ``time``, s, is that of its
    image. If it is ``brief``, only what a calibration needs of it is measured: it is reported with its own pose and the
    overlaps.
    """

    name: str
    data: FrameData | Callable[[], FrameData]
    result: Result
    keypoints: Float64 | None = None
    time: float | None = None
    brief: bool = False

    @property
    def lacks(self) -> str:
        """What it lacks to be solved with others, in words: a pose, or readings of all outer joints; else empty."""
        if self.result.camera_from_root is None or self.result.covariance is None:
            return "no pose: " + "; ".join(self.result.reasons or ("the frame failed",))
        if np.isnan(outer_readings([self.result.readings])).any():
            return NOT_READ
        return ""

    def with_turned_views(self, rotations: Mapping[str, Float64]) -> Self:
        """Return the frame whose own result says by how much its further views are turned still, if they are turned.

        Parameters
        ----------
        rotations
            The rotations (3,), rad, by which the views differ from the rig's file.
        """
        checks = tuple(
            replace(check, rotation_deg=check.rotation_deg - np.degrees(rotations[check.name]))
            if check.name in rotations
            else check
            for check in self.result.view_fits
        )
        return replace(self, result=replace(self.result, view_fits=checks))


@dataclass(frozen=True, eq=False)
class ReportTask:
    """Arguments of `report_task`.

    ``result`` is the frame's own result, ``fit`` its fit with the session's prior and ``covariance`` (D, D) that of the
    fit, including the calibration's. ``predicted`` are the pose and joints that the other frames predict. ``base``
    (4, 4) is the camera_from_base of the fit and the corrected readings, ``doubts`` the texts of reasons to doubt the
    frame. If ``agree`` is true, the frame's new result is the fit, otherwise its own result. ``brief`` is as in
    `SessionFrame`, ``camera_errors`` (6, 6) the covariance of `PARAMETERS`.
    """

    stored: StoredFrame
    result: Result
    fit: FrameFit
    covariance: Float64
    predicted: Posed
    base: Float64
    doubts: tuple[str, ...]
    agree: bool
    camera_errors: Float64
    brief: bool = False


@dataclass(frozen=True, eq=False)
class LeaveOneOutPrediction:
    """Prediction of a frame by the session's other frames: camera_from_root (4, 4) and joints (J,), rad.

    ``iou`` is the intersection over union of the predicted silhouette and the mask, ``contour_px`` the median distance
    of their contours, px.
    """

    camera_from_root: Float64
    joints: Float64
    iou: float
    contour_px: float


@dataclass(frozen=True, eq=False)
class FrameReport:
    """A frame's result with the session's prior, its leave-one-out prediction; whether the mask lacks a jaw's end."""

    result: Result
    leave_one_out: LeaveOneOutPrediction
    end_missing: bool


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

    def restored(self, body: Body, camera: Camera | None = None) -> FrameView:
        """Return the view with its images and a renderer; with another camera, if given."""
        mask = self.mask.restored()
        counts = np.ones_like(mask) if self.counts is None else self.counts.restored()
        camera = self.evidence.camera if camera is None else camera
        evidence = replace(self.evidence, mask=mask, weight=counts.astype(np.float32), camera=camera)
        return FrameView(self.name, evidence, Renderer(body, camera, threads=1), self.view_from_camera)


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
            ignore = np.logical_or.reduce(hidden) if hidden else None
            one = FrameView.of(view, body, ignore, tips, seed=config.seed, features=features)
            if features and (held := held_in(one, own)) is not None:
                hidden.append(held)
                one = FrameView.of(view, body, np.logical_or.reduce(hidden), tips, seed=config.seed)
            views.append(one)
        known = with_noise(OwnEstimate.of(views, own), views, config)
        return cls(tuple(map(StoredView.of, views)), data.camera, known)


def camera_remarks(stored: StoredFrame) -> tuple[str, ...]:
    """Return what is unusual about the camera files of a frame."""
    further = [view for view in stored.views if not np.array_equal(view.view_from_camera, np.eye(4))]
    of_views = (f"view {view.name}: {text}" for view in further for text in view.evidence.camera.remarks)
    return (*stored.camera.remarks, *of_views)


def changed(camera: Camera, change: Float64) -> Camera:
    """Return a camera after a change (3,): the logarithm of the focal length's factor, and the centre's shift over it.

    InputError as `Camera.changed`.
    """
    right, down = (camera.fx * change[1:]).tolist()
    return camera.changed(float(np.exp(change[0])), (right, down))


def gather_task(
    body: Body, config: EstimateConfig, task: tuple[SessionFrame, Mapping[str, Float64], Float64 | None]
) -> StoredFrame:
    """Read a frame with a pose, gather its evidence, and measure its own estimate.

    The task is the frame, the rotations (3,), rad, by name of views that differ from the rig's file, and the change
    (3,) of all cameras, as of `changed`, None for those of the files.
    """
    frame, turns, change = task
    data = frame.data if isinstance(frame.data, FrameData) else frame.data()
    views = turned_views(data.views, turns)
    if change is not None:
        views = tuple(replace(view, camera=changed(view.camera, change)) for view in views)
    own = posed(frame.result, body.instrument.joint_names)
    data = replace(data, views=views)
    return StoredFrame.of(data, own, body, config, frame.keypoints, features=not frame.brief)


def fit_task(
    body: Body,
    config: EstimateConfig,
    task: tuple[StoredFrame, Expected, tuple[Posed, ...], FitPreset, int | None, SeenAs],
) -> FrameFit:
    """Fit a frame to its outline, with the session's prediction as a prior.

    The task is the frame's stored evidence, what is expected of it, the starts and how the fit is found, as in
    `fit_frame`, the number of the view that shows the blocks, and these with their values.
    """
    stored, expected, starts, preset, shown, blocks = task
    views, by = [], ViewAsSeen(stored.camera)
    for view in stored.views:
        by = ViewAsSeen(view.evidence.camera)
        for block, values in blocks:
            by = block.seen(by, values)
        views.append(view.restored(body, by.camera))
    fit = partial(fit_frame, views, config, expected, starts, stored.own, preset=preset)
    return fit(margin=by.margin, blocks=[block for block, _ in blocks], shown=shown)[0]


def report_task(body: Body, config: EstimateConfig, task: ReportTask) -> FrameReport:
    """Make a frame's result, and measure the quality of its leave-one-out prediction."""
    started = time.perf_counter()
    views = [view.restored(body) for view in task.stored.views]
    readings, _, _ = split_readings(body.instrument, task.result.readings, config)
    poses = Posed.stacked([task.predicted, task.fit.at])
    if task.brief:
        of_views, rays = [[measure_overlap(view, at) for at in (task.predicted, task.fit.at)] for view in views], 0
    else:
        of_views, rays = measure_views(views, readings, poses, config)
    predicted = pooled_quality([qualities[0] for qualities in of_views])
    own_result = task.result
    if task.brief:
        result = replace(own_result, quality=pooled_quality([qualities[1] for qualities in of_views]))
    elif task.agree:
        result = _result_of_fit(body, config, task, views, readings, [qualities[1] for qualities in of_views])
        result = replace(
            result,
            evaluations=own_result.evaluations + sum(view.renderer.poses for view in views),
            rays=own_result.rays + rays,
            seconds=own_result.seconds + time.perf_counter() - started,
        )
    else:
        result = replace(own_result, status="doubtful", reasons=(*own_result.reasons, *task.doubts))
    leave_one_out = LeaveOneOutPrediction(
        task.predicted.pose,
        task.predicted.joints,
        predicted.iou,
        predicted.contour_px_median,
    )
    return FrameReport(result, leave_one_out, jaw_end_missing(views[0], task.fit.at))


def _result_of_fit(
    body: Body,
    config: EstimateConfig,
    task: ReportTask,
    views: Sequence[FrameView],
    readings: Readings,
    qualities: Sequence[Quality],
) -> Result:
    """Return the result of a frame that agrees with the session; ``qualities`` are those of its fit in each view."""
    own_result, fit, main = task.result, task.fit, views[0]
    quality = pooled_quality(qualities)
    covariance = rough_covariance(task.covariance, main.noise_at(fit.at), quality, main.evidence.camera.pixel_scale)
    of_camera = covariance_by_camera(body.instrument, main.evidence.camera, fit.at, task.camera_errors)
    error = expected_error(body.instrument, fit.at, covariance, of_camera)
    tips, tips_px = locate_tips(body.instrument, task.stored.camera, fit.at)
    doubts, remarks = doubts_in_views(fit.at, views, qualities, error, config.trust, "solved")
    doubts += task.doubts
    names = body.instrument.joint_names
    of_view = dict(zip([view.name for view in views], qualities, strict=True))
    return replace(
        own_result,
        status="doubtful" if doubts else "ok",
        reasons=tuple(doubts),
        warnings=(*own_result.warnings, *remarks),
        camera_from_root=fit.at.pose,
        joints=dict(zip(names, fit.at.joints.tolist(), strict=True)),
        camera_from_base=task.base,
        source="session",
        change=_change(own_result, fit, names),
        quality=quality,
        tips=tips,
        tips_px=tips_px,
        covariance=covariance,
        expected_error=error,
        mode_probability=None,
        tip_probability=tip_probability(error.of_tips_mm, config.trust.tip_mm),
        alternatives=_alternatives(own_result, fit, names, readings),
        view_fits=tuple(
            replace(check, quality=of_view.get(check.name, check.quality)) for check in own_result.view_fits
        ),
    )


def _change(own_result: Result, fit: FrameFit, names: tuple[str, ...]) -> dict[str, Any] | None:
    """Describe the change from the frame's own result to the fit, mm and degrees; None if it had no pose."""
    if own_result.camera_from_root is None:
        return None
    moved = change_between(own_result.camera_from_root, fit.at.pose)
    return {
        "translation_mm": round(1e3 * float(np.linalg.norm(moved[:3])), 6),
        "rotation_deg": round(float(np.degrees(np.linalg.norm(moved[3:]))), 6),
        "joints_deg": {
            name: round(float(np.degrees(value - own_result.joints[name])), 6)
            for name, value in zip(names, fit.at.joints, strict=True)
        },
    }


def _alternatives(
    own_result: Result, fit: FrameFit, names: tuple[str, ...], readings: Readings
) -> tuple[Alternative, ...]:
    """List the frame's own pose and its alternatives, without those in the mode of the fit."""
    modes = list(own_result.alternatives)
    if own_result.camera_from_root is not None and own_result.quality is not None:
        distance = reading_distance(readings, posed(own_result, names).joints)
        loss, iou = own_result.quality.loss, own_result.quality.iou
        modes.insert(0, Alternative(own_result.camera_from_root, own_result.joints, loss, iou, "other mode", distance))
    return tuple(mode for mode in modes if are_distinct(posed(mode, names), fit.at))
