"""Calibration with a camera that is refined beside the base, from a file whose focal length is 10 % off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory

from dvrk_cmaes import (
    Body,
    EstimateConfig,
    FrameData,
    InputError,
    SessionFrame,
    SolvedSession,
    calibrate_session,
    estimate,
)

SCALE = 1.1
"""True focal length, relative to that of the file."""

WRONG = SMALL.changed(1 / SCALE, (0.0, 0.0))
SETTINGS = EstimateConfig()


def as_seen_with(frame: SessionFrame) -> SessionFrame:
    """Return a frame with the wrong camera, and its own result at the depth that this camera gives."""
    assert isinstance(frame.data, FrameData)
    assert frame.result.camera_from_root is not None
    pose = frame.result.camera_from_root.copy()
    pose[2, 3] /= SCALE
    result = replace(frame.result, camera_from_root=pose, alternatives=())
    seen = replace(frame.data.views[0], camera=WRONG)
    return replace(frame, data=replace(frame.data, views=(seen,)), result=result)


@pytest.fixture(scope="module")
def frames(bundled_body: Body) -> list[SessionFrame]:
    return [as_seen_with(one) for one in make_frames_in_memory(bundled_body, 10, level="clean")[2]]


@pytest.fixture(scope="module")
def refined(bundled_body: Body, frames: list[SessionFrame]) -> SolvedSession:
    return calibrate_session(frames, bundled_body, config=SETTINGS, refine_camera=True)


def test_focal_length_is_found_and_applied(refined: SolvedSession) -> None:
    camera = refined.calibration.blocks["camera"]
    assert camera.applied
    assert camera.doubt.startswith("the camera file is contradicted: ")
    assert np.exp(camera.values[0]) == pytest.approx(SCALE, abs=0.02)
    right = refined.calibration.corrected(WRONG)
    assert right.fx == pytest.approx(SMALL.fx, rel=0.02)
    assert refined.calibration.remarks[0].endswith("; which is used")
    assert refined.calibration.doubts == ()


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


def test_camera_whose_estimate_is_not_plausible_is_refused(
    bundled_body: Body, frames: list[SessionFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dvrk_cmaes.calibration.session_camera.PLAUSIBLE", 0.2)  # 0.06 in the logarithm of the factor
    with pytest.raises(InputError, match=r"--refine-camera: camera: its estimate .* is not plausible; .* insertion"):
        calibrate_session(frames, bundled_body, config=SETTINGS, refine_camera=True)
