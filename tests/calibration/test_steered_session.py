"""Sessions of masks whose endoscope was steered: with readings of its arm and without, each frame has its own base."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.session_worlds import SMALL, near_the_truth, with_result

from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.endoscope import in_tip
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.config import EstimateConfig, SessionConfig
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.geometry import change_between
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.moving_arm import MOTION_LEVELS
from dvrk_cmaes.synth.recording import RecordedArm, record_arm
from dvrk_cmaes.synth.session import SessionPlan
from dvrk_cmaes.synth.truth import exact_mask

FRAMES = 20
QUICK = EstimateConfig(session=SessionConfig(test_camera=False))


@pytest.fixture(scope="module")
def world(bundled_body: Body) -> tuple[RecordedArm, list[SessionFrame]]:
    """Every tenth frame of a steered recording, with exact masks and results near the truth."""
    plan = SessionPlan(bundled_body, SMALL, LEVELS["clean"], "video", 10 * FRAMES, 3, {}, steered=True)
    arm, rng = record_arm(plan, MOTION_LEVELS["clean"], np.random.default_rng(3)), np.random.default_rng(4)
    frames = []
    for k in range(5, 10 * FRAMES, 10):
        readings = {name: float(values[k]) for name, values in arm.readings.items()}
        result = near_the_truth(bundled_body.instrument, f"{k:04d}", arm.truths[k], readings, rng)
        mask = exact_mask(bundled_body, SMALL, arm.truths[k])
        frames.append(SessionFrame(f"{k:04d}", FrameData.of(mask, SMALL, None), result, time=k / 30))
    return arm, frames


def without_ecm(frame: SessionFrame) -> SessionFrame:
    """Return a frame without the readings of the endoscope's arm."""
    read = {name: value for name, value in frame.result.readings.items() if name not in ECM_JOINTS}
    return with_result(frame, readings=read)


def base_errors(solved: SolvedSession, arm: RecordedArm, frames: list[SessionFrame]) -> np.ndarray:
    """Return the errors of the base in each frame, mm, at the instrument's root, that the calibration states."""
    assert arm.steering is not None
    bases = arm.steering.camera_from_first @ arm.base
    out = []
    for frame in frames:
        there = solved.calibration.at(frame.result.readings, frame=frame.name, time=frame.time)
        assert isinstance(there, SessionCalibration)
        off = change_between(there.camera_from_base, bases[int(frame.name)])
        out.append(np.abs(off) / np.sqrt(np.diag(there.covariance)[:6]))
    return np.array(out)


def test_camera_in_the_tip_and_bases_are_found(
    bundled_body: Body, world: tuple[RecordedArm, list[SessionFrame]]
) -> None:
    arm, frames = world
    assert arm.steering is not None
    solved = calibrate_session(frames, bundled_body, config=QUICK)
    found = solved.calibration.endoscope
    assert found is not None
    assert found.tip_from_camera is not None
    assert found.ecm_from_base is not None
    off = in_tip(found.tip_from_camera) @ change_between(found.tip_from_camera, arm.steering.tip_from_camera)
    assert (np.abs(off) < 3 * np.array(found.std_tip_from_camera)).all()
    truth = np.array(arm.steering.describe(arm.base)["ecm_from_base"])
    off = change_between(found.ecm_from_base, truth)
    assert (np.abs(off) < 3 * np.array(found.std_ecm_from_base)).all()
    assert np.median(base_errors(solved, arm, frames)) < 1.5
    assert sum(result.status == "ok" for result in solved.results.values()) >= FRAMES - 3


def test_without_readings_each_piece_has_its_base(
    bundled_body: Body, world: tuple[RecordedArm, list[SessionFrame]]
) -> None:
    arm, frames = world
    without = [without_ecm(frame) for frame in frames]
    solved = calibrate_session(without, bundled_body, config=QUICK)
    found = solved.calibration.endoscope
    assert found is not None
    assert found.tip_from_camera is None
    assert len(found.bases) == 4
    assert any("moved between frames" in text for text in solved.calibration.remarks)
    errors = base_errors(solved, arm, without)
    assert np.median(errors) < 1.5


def test_still_endoscope_with_readings_is_as_without(
    bundled_body: Body, world: tuple[RecordedArm, list[SessionFrame]]
) -> None:
    _, frames = world
    still = dict(zip(ECM_JOINTS, (0.1, 0.2, 0.1, 0.3), strict=True))
    some = [with_result(frame, readings={**frame.result.readings, **still}) for frame in frames[:4]]
    without = [without_ecm(frame) for frame in some]
    one, other = (calibrate_session(own, bundled_body, config=QUICK).calibration for own in (some, without))
    assert one.endoscope is None
    np.testing.assert_array_equal(one.camera_from_base, other.camera_from_base)
    np.testing.assert_array_equal(one.covariance, other.covariance)
