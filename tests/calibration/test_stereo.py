"""Calibration of a session that both eyes of an endoscope saw, and estimates with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import SMALL, Truth, make_frames_in_memory
from helpers.transforms import transform

from dvrk_cmaes import (
    Body,
    EstimateConfig,
    FrameData,
    Renderer,
    Rig,
    SessionFrame,
    SolvedSession,
    calibrate_session,
    estimate,
)

pytestmark = pytest.mark.usefixtures("searches_short")

RIGHT_FROM_LEFT = transform(np.eye(3), [-0.0053, 0.0, 0.0])
RIG = Rig.stereo(SMALL, SMALL, RIGHT_FROM_LEFT)
SETTINGS = EstimateConfig()


def seen_by_both(body: Body, frame: SessionFrame, truth: Truth, *, left: bool = True) -> SessionFrame:
    """Return a frame with the right eye's mask beside that of the left eye, which is empty if ``left`` is false."""
    assert isinstance(frame.data, FrameData)
    there = Renderer(body, SMALL).masks((RIGHT_FROM_LEFT @ truth.camera_from_root)[None], truth.values[None])[0]
    mask = frame.data.mask if left else np.zeros_like(frame.data.mask)
    return replace(frame, data=FrameData.of({"left": mask, "right": there}, RIG))


@pytest.fixture(scope="module")
def one_eye(bundled_body: Body) -> tuple[np.ndarray, list[Truth], list[SessionFrame]]:
    return make_frames_in_memory(bundled_body, 5, level="clean")


@pytest.fixture(scope="module")
def both_eyes(
    bundled_body: Body, one_eye: tuple[np.ndarray, list[Truth], list[SessionFrame]]
) -> tuple[list[SessionFrame], SolvedSession]:
    _, truths, frames = one_eye
    made = [
        seen_by_both(bundled_body, frame, truth, left=k != 2)
        for k, (frame, truth) in enumerate(zip(frames, truths, strict=True))
    ]
    return made, calibrate_session(made, bundled_body, config=SETTINGS)


def test_poses_are_those_of_the_left_camera(
    one_eye: tuple[np.ndarray, list[Truth], list[SessionFrame]], both_eyes: tuple[list[SessionFrame], SolvedSession]
) -> None:
    solved = both_eyes[1]
    assert solved.calibration.left_out == {}
    for truth, result in zip(one_eye[1], solved.results.values(), strict=True):
        assert result.source == "session"
        assert result.camera_from_root is not None
        assert 1e3 * np.linalg.norm(result.camera_from_root[:3, 3] - truth.camera_from_root[:3, 3]) < 0.7
        assert result.quality is not None
        assert result.quality.iou > 0.95


def test_new_frame_is_predicted_and_fitted_in_both_eyes(
    bundled_body: Body, both_eyes: tuple[list[SessionFrame], SolvedSession]
) -> None:
    frames, solved = both_eyes
    data = frames[0].data
    assert isinstance(data, FrameData)
    masks = {view.name: view.mask for view in data.views}
    found = estimate(masks, RIG, frames[0].result.readings, bundled_body, session=solved.calibration, config=SETTINGS)
    assert found.source == "session"
    together = solved.results[frames[0].name].camera_from_root
    assert found.camera_from_root is not None
    assert together is not None
    apart = found.camera_from_root[:3, :3].T @ (found.camera_from_root[:3, 3] - together[:3, 3])  # in the root's axes
    assert found.covariance is not None
    # one standard deviation of each axis in the mean: the frame is one of those that were solved together
    assert float(apart @ np.linalg.solve(found.covariance[:3, :3], apart)) < 3.0


def test_focal_length_of_both_eyes_is_refined_together(bundled_body: Body) -> None:
    """Both files state a focal length that is 8 % short."""
    base, truths, frames = make_frames_in_memory(bundled_body, 10, level="clean")
    short = SMALL.changed(1 / 1.08, (0.0, 0.0))
    rig, made = Rig.stereo(short, short, RIGHT_FROM_LEFT), []
    for frame, truth in zip(frames, truths, strict=True):
        data = seen_by_both(bundled_body, frame, truth).data
        assert isinstance(data, FrameData)
        assert frame.result.camera_from_root is not None
        nearer = frame.result.camera_from_root.copy()
        nearer[2, 3] /= 1.08
        result = replace(frame.result, camera_from_root=nearer, alternatives=())
        masks = {view.name: view.mask for view in data.views}
        made.append(replace(frame, data=FrameData.of(masks, rig), result=result))
    calibration = calibrate_session(made, bundled_body, refine_camera=True).calibration
    assert np.exp(calibration.blocks["camera"].values[0]) == pytest.approx(1.08, abs=0.02)
    assert 1e3 * np.linalg.norm(calibration.rcm - base[:3, 3]) < 4
    views = calibration.corrected_views(rig.views)
    assert [view.camera.fx / SMALL.fx for view in views] == pytest.approx([1.0, 1.0], abs=0.02)
