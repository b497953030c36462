"""The drawings of a frame of a calibrated session, made in any process."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.calibration.frame_task import LeaveOneOutPrediction
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.draw.left_out_overlay import draw_left_out
from dvrk_cmaes.draw.view_overlays import draw_views, drawn_views
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.io.atomic import encoded_image
from dvrk_cmaes.results.layers import FrameLayers
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import layers_of_frame
from dvrk_cmaes.silhouette import Body, Renderer


@dataclass(frozen=True, eq=False)
class DrawTask:
    """Draw a frame's result and what the session's other frames predict for it; ``files`` has a mask.

    ``rig`` is that of the camera files, ``calibrated`` the one with which the session was solved, and ``evidence`` what
    was found with it.
    """

    files: FrameFiles
    rig: Rig
    calibrated: Rig
    result: Result
    left_out: LeaveOneOutPrediction
    evidence: Evidence


@dataclass(frozen=True)
class CalibrationPictures:
    """The drawings of a frame: the overlay of its result and that of its leave-one-out prediction, JPEG; its layers."""

    overlay: bytes
    left_out: bytes
    layers: FrameLayers


def draw_task(body: Body, config: EstimateConfig, task: DrawTask) -> CalibrationPictures:
    """Draw one frame."""
    data = read_frame(task.files, task.calibrated)
    # a frame that is left out keeps its own result
    drawn = data if task.result.source == "session" else read_frame(task.files, task.rig)
    overlay = draw_views(task.result, drawn.views, body, task.evidence if drawn is data else None)
    left_out = task.left_out
    shown = []
    for view in drawn_views(data.views):
        renderer, pose = Renderer(body, view.camera, threads=1), view.view_from_camera @ left_out.camera_from_root
        predicted = renderer.masks(pose[None], left_out.joints[None])[0]
        shown.append(draw_left_out(view.mask, predicted, left_out.iou, left_out.contour_px, image=view.image))
    second = np.concatenate(shown, axis=1)
    layers = layers_of_frame(task.result, drawn, body)
    return CalibrationPictures(encoded_image("overlay.jpg", overlay), encoded_image("left_out.jpg", second), layers)
