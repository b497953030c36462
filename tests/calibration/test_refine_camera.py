"""Calibration with a camera that is refined beside the base, from a file whose focal length is 10 % off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory
from helpers.transforms import apply

from dvrk_cmaes import (
    Body,
    Camera,
    EstimateConfig,
    FrameData,
    InputError,
    SessionFrame,
    SolvedSession,
    calibrate_session,
    estimate,
)
from dvrk_cmaes.calibration.session_camera import covariance_of_camera
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Posed

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


def test_covariance_of_a_pose_has_the_error_of_the_refined_camera(
    bundled_body: Body, frames: list[SessionFrame], refined: SolvedSession
) -> None:
    """The same outline is seen with other cameras from where the covariance says."""
    camera = refined.calibration.camera
    assert camera is not None
    right = refined.calibration.corrected(WRONG)
    result = refined.results[frames[0].name]
    assert result.camera_from_root is not None
    assert result.covariance is not None
    at = Posed(result.camera_from_root, np.array(list(result.joints.values())))
    links = bundled_body.instrument.tips(at.joints)
    seen = right.project(apply(at.pose, links))
    for number, (focal, shift) in enumerate([(0.01, (0.0, 0.0)), (0.0, (5.0, 0.0)), (0.0, (0.0, 5.0))]):
        std = [0.0, 0.0, 0.0]
        std[number] = focal or 5.0
        alone = replace(camera, std_focal_scale=std[0] * camera.focal_scale, std_principal_point_px=(std[1], std[2]))
        values, vectors = np.linalg.eigh(covariance_of_camera(alone, at, right)[:6, :6])
        step = np.concatenate([np.sqrt(values[-1]) * vectors[:, -1], np.zeros(3)])
        other = right.changed(float(np.exp(focal)), shift)
        moved = min(off(other, at.moved(sign * step), links, seen) for sign in (1, -1))
        assert moved < 0.15 * off(other, at, links, seen) + 0.05
    assert (np.diag(result.covariance)[:3] > np.diag(covariance_of_camera(camera, at, right))[:3]).all()
    assert not covariance_of_camera(replace(camera, applied=False), at, right).any()


def test_camera_whose_estimate_is_not_plausible_is_refused(
    bundled_body: Body, frames: list[SessionFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dvrk_cmaes.calibration.session_camera.PLAUSIBLE", 0.2)  # 0.06 in the logarithm of the factor
    with pytest.raises(InputError, match=r"--refine-camera: camera: its estimate .* is not plausible; .* insertion"):
        calibrate_session(frames, bundled_body, config=SETTINGS, refine_camera=True)


def off(camera: Camera, at: Posed, points: np.ndarray, seen: np.ndarray) -> float:
    """Return how far points of the root's frame are seen from where they should be, px."""
    return float(np.linalg.norm(camera.project(apply(at.pose, points)) - seen, axis=1).mean())
