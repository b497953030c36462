"""The drawings of a frame of a calibrated session, made in any process."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.calibration.frame_task import LeaveOneOutPrediction
from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.draw.left_out_overlay import draw_left_out
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.io.atomic import encoded_image
from dvrk_cmaes.results.layers import FrameLayers
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import draw_frame, layers_of_frame, read_masked_frame, seen_in
from dvrk_cmaes.silhouette import Body, Renderer


@dataclass(frozen=True, eq=False)
class DrawTask:
    """Draw a frame's result and what the session's other frames predict for it; ``files`` has a mask.

    ``camera`` is that of the camera file or the rig, ``calibrated`` the one with which the session was solved, and
    ``evidence`` what was found with it.
    """

    files: FrameFiles
    camera: Camera | Rig
    calibrated: Camera | Rig
    result: Result
    left_out: LeaveOneOutPrediction
    evidence: Evidence


@dataclass(frozen=True)
class Pictures:
    """The drawings of a frame: the overlay of its result and that of its leave-one-out prediction, JPEG; its layers."""

    overlay: bytes
    left_out: bytes
    layers: FrameLayers


def draw_task(body: Body, config: EstimateConfig, task: DrawTask) -> Pictures:
    """Draw one frame."""
    data = read_masked_frame(task.files, task.calibrated)
    # a frame that is left out keeps its own result
    drawn = data if task.result.source == "session" else read_masked_frame(task.files, task.camera)
    overlay = draw_frame(task.result, task.files, drawn, body, task.evidence if drawn is data else None)
    left_out = task.left_out
    shown = []
    for view in seen_in(data):
        renderer, pose = Renderer(body, view.camera, threads=1), view.view_from_camera @ left_out.camera_from_root
        predicted = renderer.masks(pose[None], left_out.joints[None])[0]
        shown.append(draw_left_out(view.mask, predicted, left_out.iou, left_out.contour_px, image=view.image))
    second = np.concatenate(shown, axis=1)
    layers = layers_of_frame(task.result, drawn, body)
    return Pictures(encoded_image("overlay.jpg", overlay), encoded_image("left_out.jpg", second), layers)
