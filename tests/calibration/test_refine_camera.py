"""Calibration with a camera that is refined beside the base, from a file whose focal length is 10 % off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory

from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.config import EstimateConfig, SessionConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.silhouette import Body

SCALE = 1.1
"""True focal length, relative to that of the file."""

WRONG = SMALL.changed(1 / SCALE, (0.0, 0.0))
SETTINGS = EstimateConfig(session=SessionConfig(rounds=2))


def as_seen_with(frame: SessionFrame) -> SessionFrame:
    """Return a frame with the wrong camera, and its own result at the depth that this camera gives."""
    assert isinstance(frame.data, FrameData)
    assert frame.result.camera_from_root is not None
    pose = frame.result.camera_from_root.copy()
    pose[2, 3] /= SCALE
    result = replace(frame.result, camera_from_root=pose, alternatives=())
    return replace(frame, data=frame.data.with_camera(WRONG), result=result)


@pytest.fixture(scope="module")
def frames(bundled_body: Body) -> list[SessionFrame]:
    return [as_seen_with(one) for one in make_frames_in_memory(bundled_body, 10, level="clean")[2]]


@pytest.fixture(scope="module")
def refined(bundled_body: Body, frames: list[SessionFrame]) -> SolvedSession:
    return calibrate_session(frames, bundled_body, config=SETTINGS, refine_camera=True)


def test_focal_length_is_found_and_applied(refined: SolvedSession) -> None:
    camera = refined.calibration.camera
    assert camera is not None
    assert camera.applied
    assert camera.contradicts
    assert camera.focal_scale == pytest.approx(SCALE, abs=0.02)
    right = refined.calibration.corrected(WRONG)
    assert right.fx == pytest.approx(SMALL.fx, rel=0.02)
    assert refined.calibration.warnings[0].endswith("; which is used")


def test_session_agrees_with_refined_camera(bundled_body: Body, refined: SolvedSession) -> None:
    base = make_frames_in_memory(bundled_body, 10, level="clean")[0]
    assert refined.calibration.left_out == {}
    assert 1e3 * np.linalg.norm(refined.calibration.rcm - base[:3, 3]) < 4
    assert np.mean([iou for iou, _ in refined.calibration.leave_one_out.values()]) > 0.85


def test_new_frame_is_estimated_with_refined_camera(
    bundled_body: Body, frames: list[SessionFrame], refined: SolvedSession
) -> None:
    frame = frames[0]
    assert isinstance(frame.data, FrameData)
    found = estimate(
        frame.data.mask, WRONG, frame.result.readings, bundled_body, session=refined.calibration, config=SETTINGS
    )
    assert found.source == "session"
    together = refined.results[frame.name].camera_from_root
    assert found.camera_from_root is not None
    assert together is not None
    assert 1e3 * np.linalg.norm(found.camera_from_root[:3, 3] - together[:3, 3]) < 1


def test_few_frames_refine_no_camera(bundled_body: Body, frames: list[SessionFrame]) -> None:
    with pytest.raises(InputError, match="camera: 5 frames; at least 10 are needed"):
        calibrate_session(frames[:5], bundled_body, config=SETTINGS, refine_camera=True)
