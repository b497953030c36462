"""Tasks on one frame of a session, which can run in any process: gather evidence, fit, and report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.frame_fit import FrameFit, PoseAndJoints, camera_terms, fit_frame
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evidence.gather import Evidence, gather_evidence
from dvrk_cmaes.evidence.joint_prior import Readings, reading_distance, split_readings
from dvrk_cmaes.evidence.outline_noise import measure_noise
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.geometry import change_between
from dvrk_cmaes.pose.covariance import rough_covariance
from dvrk_cmaes.pose.doubts import doubts_of_fit
from dvrk_cmaes.pose.expected_error import expected_error, locate_tips
from dvrk_cmaes.pose.quality import measure_quality
from dvrk_cmaes.pose.refine.priors import PosePrior
from dvrk_cmaes.pose.search.modes import HasPose, are_distinct
from dvrk_cmaes.results.result import Alternative, Quality, Result
from dvrk_cmaes.silhouette import Body, Renderer

Float64 = NDArray[np.float64]
T = TypeVar("T")
R = TypeVar("R")

Run = Callable[[Callable[[Body, EstimateConfig, T], R], Sequence[T]], list[R]]
"""Applies a function of body, settings and task to all tasks, and returns the values in the tasks' order."""


@dataclass(frozen=True, eq=False)
class SessionFrame:
    """A frame of a session.

    ``data`` are its data or a function that reads them, picklable where several processes are used. ``result`` is its
    own result, estimated without the session. ``keypoints`` (2, 2), px, are the jaw tips; ``time``, s, is that of its
    image.
    """

    name: str
    data: FrameData | Callable[[], FrameData]
    result: Result
    keypoints: Float64 | None = None
    time: float | None = None


@dataclass(frozen=True, eq=False)
class DataOfCamera:
    """Data of a frame, as in `SessionFrame`, with another camera, for images of the same size."""

    data: FrameData | Callable[[], FrameData]
    camera: Camera

    def __call__(self) -> FrameData:
        """Read the data."""
        return replace(self.data if isinstance(self.data, FrameData) else self.data(), camera=self.camera)


@dataclass(frozen=True, eq=False)
class StoredEvidence:
    """Evidence of a frame with one bit a pixel, small enough to be stored for all frames and sent to processes.

    ``evidence`` has all parts but the images ``mask`` and ``weight``, which are (0, 0); ``mask`` and ``counts`` are
    those images (H, W) as packed bits. ``counts`` tells which pixels have weight 1, None where all have.
    """

    evidence: Evidence
    mask: NDArray[np.uint8]
    counts: NDArray[np.uint8] | None

    @classmethod
    def of(cls, evidence: Evidence) -> StoredEvidence:
        """Pack evidence whose weights are 0 or 1."""
        counts = None if evidence.weight.all() else np.packbits(evidence.weight > 0)
        empty = np.empty((0, 0), np.float32)
        return cls(replace(evidence, mask=empty > 0, weight=empty), np.packbits(evidence.mask), counts)

    def restored(self) -> Evidence:
        """Return the evidence with its images."""
        camera = self.evidence.camera
        shape = camera.height, camera.width
        mask = np.unpackbits(self.mask, count=shape[0] * shape[1]).reshape(shape)
        if self.counts is None:
            weight = np.ones(shape, np.float32)
        else:
            weight = np.unpackbits(self.counts, count=mask.size).reshape(shape).astype(np.float32)
        return replace(self.evidence, mask=mask.astype(np.bool_), weight=weight)


@dataclass(frozen=True, eq=False)
class FitTask:
    """Arguments of `fit_task`: the frame's stored evidence and readings by name; the others as in `fit_frame`.

    ``camera`` is that of the fit, where it is not that of the evidence and of the own estimate.
    """

    stored: StoredEvidence
    readings: Mapping[str, float]
    expected: PosePrior
    starts: tuple[PoseAndJoints, ...]
    own_estimate: PoseAndJoints | None
    camera: Camera | None = None


@dataclass(frozen=True, eq=False)
class CameraTask:
    """Arguments of `camera_task`: as in `FitTask`, and pose and joints with a changed camera."""

    stored: StoredEvidence
    readings: Mapping[str, float]
    fitted: PoseAndJoints
    own_estimate: PoseAndJoints
    camera: Camera


@dataclass(frozen=True, eq=False)
class ReportTask:
    """Arguments of `report_task`.

    ``result`` is the frame's own result, ``fit`` its fit with the session's prior and ``covariance`` (D, D) that of the
    fit, including the calibration's. ``predicted`` are the pose and joints that the other frames predict, and
    ``predicted_std`` (J,) the standard deviations of these joints, rad. ``base`` (4, 4) is the camera_from_base of the
    fit and the corrected readings, ``doubts`` the texts of reasons to doubt the frame. If ``agree`` is true, the
    frame's new result is the fit, otherwise its own result. ``config`` is stored with the result.
    """

    stored: StoredEvidence
    result: Result
    fit: FrameFit
    covariance: Float64
    predicted: PoseAndJoints
    predicted_std: Float64
    base: Float64
    doubts: tuple[str, ...]
    agree: bool
    config: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class LeaveOneOutPrediction:
    """Prediction of a frame by the session's other frames: camera_from_root (4, 4) and joints (J,), rad.

    ``joint_std`` (J,), rad, are the standard deviations of the joints.
    ``iou`` is the intersection over union of the predicted silhouette and the mask, ``contour_px`` the median distance
    of their contours, px.
    """

    camera_from_root: Float64
    joints: Float64
    joint_std: Float64
    iou: float
    contour_px: float


@dataclass(frozen=True, eq=False)
class FrameReport:
    """A frame's result with the session's prior, and its leave-one-out prediction."""

    result: Result
    leave_one_out: LeaveOneOutPrediction


def gather_task(body: Body, config: EstimateConfig, frame: SessionFrame) -> StoredEvidence:
    """Read a frame and gather its evidence."""
    data = frame.data if isinstance(frame.data, FrameData) else frame.data()
    evidence = gather_evidence(
        data.mask, data.camera, body.instrument, ignore=data.ignore, keypoints=frame.keypoints, seed=config.seed
    )
    return StoredEvidence.of(evidence)


@dataclass(frozen=True, eq=False)
class _Scene:
    """A frame's renderer and evidence, and the readings and limits of the instrument's joints."""

    renderer: Renderer
    evidence: Evidence
    readings: Readings


def _scene(
    body: Body,
    config: EstimateConfig,
    stored: StoredEvidence,
    readings: Mapping[str, float],
    camera: Camera | None = None,
) -> _Scene:
    """Restore a frame's evidence, with another camera if one is given, and make its renderer."""
    evidence = stored.restored()
    if camera is not None:
        evidence = replace(evidence, camera=camera)
    of_instrument, _, _ = split_readings(body.instrument, readings, config)
    return _Scene(Renderer(body, evidence.camera, threads=1), evidence, of_instrument)


def fit_task(body: Body, config: EstimateConfig, task: FitTask) -> FrameFit:
    """Fit a frame to its outline, with the session's prediction as a prior."""
    scene = _scene(body, config, task.stored, task.readings, task.camera)
    return fit_frame(
        scene.renderer,
        scene.evidence,
        scene.readings,
        config,
        task.expected,
        task.starts,
        task.own_estimate,
        own_camera=None if task.camera is None else task.stored.evidence.camera,
    )


def camera_task(body: Body, config: EstimateConfig, task: CameraTask) -> tuple[Float64, Float64]:
    """Compute the outline's information and slope about a frame's pose and about the camera, as `camera_terms`."""
    scene = _scene(body, config, task.stored, task.readings)
    return camera_terms(
        scene.renderer, scene.evidence, scene.readings, config, task.fitted, task.own_estimate, task.camera
    )


def report_task(body: Body, config: EstimateConfig, task: ReportTask) -> FrameReport:
    """Make a frame's result, and measure the quality of its leave-one-out prediction."""
    started = time.perf_counter()
    scene = _scene(body, config, task.stored, task.result.readings)
    poses: list[HasPose] = [_Posed(*task.predicted), task.fit]
    qualities, rays = measure_quality(
        scene.renderer,
        scene.evidence,
        scene.readings,
        poses,
        config.weights,
        decay=config.decay_px,
        field=config.distance_field,
    )
    own_result = task.result
    if task.agree:
        result = _result_of_fit(body, config, task, scene, qualities[1])
        result = replace(
            result,
            evaluations=own_result.evaluations + scene.renderer.poses,
            rays=own_result.rays + rays,
            seconds=own_result.seconds + time.perf_counter() - started,
        )
    else:
        result = replace(own_result, status="doubtful", reasons=(*own_result.reasons, *task.doubts))
    leave_one_out = LeaveOneOutPrediction(
        *task.predicted, task.predicted_std, qualities[0].iou, qualities[0].contour_px_median
    )
    return FrameReport(result, leave_one_out)


def _result_of_fit(body: Body, config: EstimateConfig, task: ReportTask, scene: _Scene, quality: Quality) -> Result:
    """Return the result of a frame that agrees with the session; ``quality`` is that of its fit."""
    own_result = task.result
    silhouette = scene.renderer.masks(task.fit.camera_from_root[None], task.fit.joints[None])[0]
    covariance = rough_covariance(task.covariance, measure_noise(scene.evidence.contour, silhouette), quality)
    error = expected_error(body.instrument, task.fit.camera_from_root, task.fit.joints, covariance)
    tips, tips_px = locate_tips(body.instrument, scene.evidence.camera, task.fit.camera_from_root, task.fit.joints)
    doubts = doubts_of_fit(task.fit, quality, error, scene.evidence, body.instrument, config.trust) + list(task.doubts)
    names = body.instrument.joint_names
    return replace(
        own_result,
        status="doubtful" if doubts else "ok",
        reasons=tuple(doubts),
        camera_from_root=task.fit.camera_from_root,
        joints=dict(zip(names, task.fit.joints.tolist(), strict=True)),
        camera_from_base=task.base,
        source="session",
        change=_change(own_result, task.fit, names),
        quality=quality,
        tips=tips,
        tips_px=tips_px,
        covariance=covariance,
        expected_error=error,
        mode_probability=None,
        alternatives=_alternatives(own_result, task.fit, names, scene.readings),
        config=dict(task.config),
    )


@dataclass(frozen=True, eq=False)
class _Posed:
    """A pose and joints without a score, as `HasPose`."""

    camera_from_root: Float64
    joints: Float64
    score: float = 0.0


def _change(own_result: Result, fit: FrameFit, names: tuple[str, ...]) -> dict[str, Any] | None:
    """Describe the change from the frame's own result to the fit, mm and degrees; None if it had no pose."""
    if own_result.camera_from_root is None:
        return None
    moved = change_between(own_result.camera_from_root, fit.camera_from_root)
    return {
        "translation_mm": round(1e3 * float(np.linalg.norm(moved[:3])), 6),
        "rotation_deg": round(float(np.degrees(np.linalg.norm(moved[3:]))), 6),
        "joints_deg": {
            name: round(float(np.degrees(value - own_result.joints[name])), 6)
            for name, value in zip(names, fit.joints, strict=True)
        },
    }


def _alternatives(
    own_result: Result, fit: FrameFit, names: tuple[str, ...], readings: Readings
) -> tuple[Alternative, ...]:
    """List the frame's own pose and its alternatives, without those in the mode of the fit."""
    modes = list(own_result.alternatives)
    if own_result.camera_from_root is not None and own_result.quality is not None:
        joints = np.array([own_result.joints[name] for name in names])
        distance = reading_distance(readings, joints)
        loss, iou = own_result.quality.loss, own_result.quality.iou
        modes.insert(0, Alternative(own_result.camera_from_root, own_result.joints, loss, iou, "other mode", distance))
    return tuple(
        mode
        for mode in modes
        if are_distinct(
            _Posed(mode.camera_from_root, np.array([mode.joints[name] for name in names])),
            fit,
            np.deg2rad(15),
            np.deg2rad(25),
        )
    )
