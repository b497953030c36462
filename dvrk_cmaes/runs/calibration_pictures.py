"""The drawings of a frame of a calibrated session, made in any process."""

from __future__ import annotations

from dvrk_cmaes.calibration.session_frame import LeaveOneOutPrediction
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.draw.track_overlay import draw_track
from dvrk_cmaes.draw.view_overlays import draw_views, drawn_views
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.io.json_file import encoded_image
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TrackView
from dvrk_cmaes.silhouette import Body, Renderer

Task = tuple[FrameFiles, Result, LeaveOneOutPrediction, Evidence]
"""A frame's files, which have a mask, its result, what the others predict, and the evidence that was found."""


def draw_task(body: Body, config: EstimateConfig, task: Task, *, rig: Rig, calibrated: Rig) -> tuple[bytes, bytes]:
    """Draw a frame's result, and what the session's other frames predict for it.

    The evidence is that of the ``calibrated`` rig, with which the session was solved; ``rig`` is that of the camera
    files. Returns the overlay of the result and that of the prediction, JPEG.
    """
    files, result, left_out, evidence = task
    data = read_frame(files, calibrated)
    # a frame that is left out keeps its own result
    drawn = data if result.source == "session" else read_frame(files, rig)
    overlay = draw_views(result, drawn.views, body, evidence if drawn is data else None)
    shown = []
    for view in drawn_views(data.views):
        renderer, pose = Renderer(body, view.camera, threads=1), view.view_from_camera @ left_out.camera_from_root
        predicted = renderer.masks(pose[None], left_out.joints[None])[0]
        shown.append(TrackView(view.image, view.mask, predicted, (view.camera.width, view.camera.height)))
    text = f"as the other frames predict it: IoU {left_out.iou:.3f}, contour {left_out.contour_px:.1f} px"
    second = draw_track(shown, frame=result.frame, status=result.status, reasons=[text])
    return encoded_image("overlay.jpg", overlay), encoded_image("left_out.jpg", second)
