"""What is done with one frame of a session, in whatever process: fit it as the session expects, and report on it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.frame_fit import FrameView, PoseAndJoints, fit_frame
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.draw.left_out_overlay import draw_left_out
from dvrk_cmaes.draw.overlay import draw_overlay
from dvrk_cmaes.evidence.gather import Evidence, gather_evidence
from dvrk_cmaes.evidence.joint_prior import Readings, reading_distance, split_readings
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.geometry import change_between
from dvrk_cmaes.io.atomic import encoded_image
from dvrk_cmaes.pose.quality import doubts_of_fit, measure_quality
from dvrk_cmaes.pose.refine.priors import PosePrior
from dvrk_cmaes.pose.search.modes import HasPose, apart
from dvrk_cmaes.results.paths import FramePictures
from dvrk_cmaes.results.result import Alternative, Quality, Result
from dvrk_cmaes.silhouette import Body, Renderer

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SessionFrame:
    """A frame of a session: its data or what reads them, its result on its own, and when it was taken, s.

    ``data`` must be able to travel between processes where several are used.
    """

    name: str
    data: FrameData | Callable[[], FrameData]
    result: Result
    keypoints: Float64 | None = None
    time: float | None = None


@dataclass(frozen=True, eq=False)
class FitTask:
    """Fit a frame from several starts as the session expects it; ``own`` is its pose without the session."""

    frame: SessionFrame
    expected: PosePrior
    starts: tuple[PoseAndJoints, ...]
    own: PoseAndJoints | None


@dataclass(frozen=True, eq=False)
class ReportTask:
    """Report on a frame once the session is solved.

    ``view`` is its solution, of ``covariance``; ``left_out`` the pose and joints that the other frames predict;
    ``base`` its own camera_from_base, offsets taken out; ``doubts`` what the session has against it. Where it does
    ``agree``, it gets the solution, else it keeps its own result. ``draw`` asks for pictures.
    """

    frame: SessionFrame
    view: FrameView
    covariance: Float64
    left_out: PoseAndJoints
    base: Float64
    doubts: tuple[str, ...]
    agree: bool
    config: Mapping[str, Any]
    draw: bool


@dataclass(frozen=True, eq=False)
class FrameReport:
    """A frame's result, and how well the other frames predict it: overlap, and median distance of the contours, px.

    ``pictures`` where they were asked for.
    """

    result: Result
    left_out_iou: float
    left_out_px: float
    pictures: FramePictures | None


@dataclass(frozen=True, eq=False)
class _Scene:
    data: FrameData
    renderer: Renderer
    evidence: Evidence
    readings: Readings


def _scene(body: Body, config: EstimateConfig, frame: SessionFrame) -> _Scene:
    data = frame.data if isinstance(frame.data, FrameData) else frame.data()
    readings, _, _ = split_readings(body.instrument, frame.result.readings, config)
    evidence = gather_evidence(
        data.mask, data.camera, body.instrument, ignore=data.ignore, keypoints=frame.keypoints, seed=config.seed
    )
    return _Scene(data, Renderer(body, data.camera, threads=1), evidence, readings)


def fit_task(body: Body, config: EstimateConfig, task: FitTask) -> FrameView:
    """Fit one frame."""
    scene = _scene(body, config, task.frame)
    return fit_frame(scene.renderer, scene.evidence, scene.readings, config, task.expected, task.starts, task.own)


def report_task(body: Body, config: EstimateConfig, task: ReportTask) -> FrameReport:
    """Report on one frame."""
    started = time.perf_counter()
    scene = _scene(body, config, task.frame)
    seen: list[HasPose] = [_Posed(*task.left_out), task.view]
    qualities, rays = measure_quality(
        scene.renderer,
        scene.evidence,
        scene.readings,
        seen,
        config.weights,
        decay=config.decay_px,
        field=config.distance_field,
    )
    own = task.frame.result
    if task.agree:
        result = _solved(body, config, task, scene, qualities[1])
        result = replace(
            result,
            evaluations=own.evaluations + scene.renderer.poses,
            rays=own.rays + rays,
            seconds=own.seconds + time.perf_counter() - started,
        )
    else:
        result = replace(own, status="doubtful", reasons=(*own.reasons, *task.doubts))
    pictures = _pictures(body, task, scene, result, qualities[0]) if task.draw else None
    return FrameReport(result, qualities[0].iou, qualities[0].contour_px_median, pictures)


def _pictures(body: Body, task: ReportTask, scene: _Scene, result: Result, left_out: Quality) -> FramePictures:
    data, tips = scene.data, task.frame.keypoints
    overlay = draw_overlay(result, data.mask, data.camera, body, image=data.image, ignore=data.ignore, keypoints=tips)
    pose, joints = task.left_out
    predicted = scene.renderer.masks(pose[None], joints[None])[0]
    second = draw_left_out(data.mask, predicted, left_out.iou, left_out.contour_px_median, image=data.image)
    return FramePictures(encoded_image("overlay.jpg", overlay), encoded_image("left_out.jpg", second))


def _solved(body: Body, config: EstimateConfig, task: ReportTask, scene: _Scene, quality: Quality) -> Result:
    """Give the result of a frame that agrees with its session."""
    own = task.frame.result
    doubts = doubts_of_fit(task.view, quality, scene.evidence, body.instrument, config.trust) + list(task.doubts)
    names = body.instrument.joint_names
    return replace(
        own,
        status="doubtful" if doubts else "ok",
        reasons=tuple(doubts),
        camera_from_root=task.view.camera_from_root,
        joints=dict(zip(names, task.view.joints.tolist(), strict=True)),
        camera_from_base=task.base,
        source="session",
        change=_change(own, task.view, names),
        quality=quality,
        covariance=task.covariance,
        alternatives=_others(own, task.view, names, scene.readings),
        config=dict(task.config),
    )


@dataclass(frozen=True, eq=False)
class _Posed:
    camera_from_root: Float64
    joints: Float64
    score: float = 0.0


def _change(own: Result, view: FrameView, names: tuple[str, ...]) -> dict[str, Any] | None:
    """Say what the session moved: mm, degrees."""
    if own.camera_from_root is None:
        return None
    moved = change_between(own.camera_from_root, view.camera_from_root)
    return {
        "translation_mm": round(1e3 * float(np.linalg.norm(moved[:3])), 6),
        "rotation_deg": round(float(np.degrees(np.linalg.norm(moved[3:]))), 6),
        "joints_deg": {
            name: round(float(np.degrees(value - own.joints[name])), 6)
            for name, value in zip(names, view.joints, strict=True)
        },
    }


def _others(own: Result, view: FrameView, names: tuple[str, ...], readings: Readings) -> tuple[Alternative, ...]:
    """List the frame's own pose and its alternatives, without the mode that the session chose."""
    modes = list(own.alternatives)
    if own.camera_from_root is not None and own.quality is not None:
        joints = np.array([own.joints[name] for name in names])
        distance = reading_distance(readings, joints)
        loss, iou = own.quality.loss, own.quality.iou
        modes.insert(0, Alternative(own.camera_from_root, own.joints, loss, iou, "other mode", distance))
    return tuple(
        mode
        for mode in modes
        if apart(
            _Posed(mode.camera_from_root, np.array([mode.joints[name] for name in names])),
            view,
            np.deg2rad(15),
            np.deg2rad(25),
        )
    )
