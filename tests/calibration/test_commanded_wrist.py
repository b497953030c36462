"""A session whose wrist and jaw readings are one constant each: they are commanded, and the session tells the modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import in_other_mode, make_frames_in_memory, make_world, true_calibration, with_result
from helpers.transforms import rotation_angle

from dvrk_cmaes import Body, EstimateConfig, SessionCalibration, SessionFrame, SolvedSession, calibrate_session
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.synth.truth import Truth

COMMANDED = {"wrist_pitch": 0.0, "wrist_yaw": 0.0, "jaw": 0.5}
IN_TWIN = (1, 4)
DOUBT = "mode in doubt: the pose is in the right mode with a probability of 0.50; the mirror twin explains the frame"

World = tuple[np.ndarray, list[Truth], list[SessionFrame]]


@pytest.fixture(scope="module")
def world(bundled_body: Body) -> World:
    """Eight frames, doubtful for their twins, with the same readings of wrist and jaw; two are in the twin's mode."""
    base, truths, frames = make_frames_in_memory(bundled_body, 8, level="clean")
    for i in IN_TWIN:
        frames[i] = in_other_mode(frames[i])
    commanded = [
        with_result(
            frame, readings=frame.result.readings | COMMANDED, status="doubtful", reasons=(DOUBT,), mode_probability=0.5
        )
        for frame in frames
    ]
    return base, truths, commanded


@pytest.fixture(scope="module")
def solved(bundled_body: Body, world: World) -> SolvedSession:
    return calibrate_session(world[2], bundled_body, config=EstimateConfig(session=SessionConfig(rounds=2)))


def test_one_warning_says_that_wrist_readings_never_move(solved: SolvedSession) -> None:
    about = [text for text in solved.calibration.warnings if "never move" in text]
    assert len(about) == 1
    assert about[0].startswith("wrist readings never move: wrist_pitch, wrist_yaw and jaw constant while the arm moves")


def test_the_document_has_the_only_reading_of_each_commanded_joint(solved: SolvedSession) -> None:
    document = solved.calibration.to_dict()
    assert document["commanded"] == COMMANDED
    assert SessionCalibration.from_dict(document).commanded == COMMANDED


def test_offsets_of_commanded_joints_are_not_told_at_other_readings(solved: SolvedSession) -> None:
    text = "offsets of wrist_pitch, wrist_yaw, jaw at other readings than the only one of each"
    assert text in solved.calibration.untold


def test_the_base_is_found_although_the_wrist_moves_and_its_readings_do_not(
    world: World, solved: SolvedSession
) -> None:
    assert np.degrees(rotation_angle(solved.calibration.camera_from_base, world[0])) < 1.0
    assert 1e3 * np.linalg.norm(solved.calibration.rcm - world[0][:3, 3]) < 1.5


def test_no_frame_whose_mode_the_session_tells_is_doubtful_for_its_twin(
    bundled_body: Body, world: World, solved: SolvedSession
) -> None:
    for frame, truth in zip(world[2], world[1], strict=True):
        result = solved.results[frame.name]
        assert result.camera_from_root is not None
        off = compare_poses(
            bundled_body.instrument, (result.camera_from_root, result.joints), (truth.camera_from_root, truth.joints)
        )
        assert off.rotation_deg < 5
        assert (result.source, result.mode_probability) == ("session", None)
        assert not [reason for reason in result.reasons if reason.startswith("mode in doubt")]


def test_measured_wrists_are_not_mentioned(bundled_body: Body, world: World) -> None:
    _, truths, frames = world
    measured = [
        with_result(frame, readings=frame.result.readings | truth.joints)
        for frame, truth in zip(frames, truths, strict=True)
    ]
    calibration = calibrate_session(
        measured, bundled_body, config=EstimateConfig(session=SessionConfig(rounds=1))
    ).calibration
    assert calibration.commanded == {}
    assert not [text for text in calibration.warnings if "never move" in text]


def test_readings_away_from_the_commanded_one_tell_less(bundled_body: Body, world: World) -> None:
    made = make_world(frames=1)
    known = true_calibration(bundled_body, *world)
    rows = np.array([[0.0, 0.0, 0.5], [0.2, 0.0, 0.5], [np.nan, 2.0, 0.5]])
    outer = np.repeat(made.model.outer, len(rows), axis=0)
    names = tuple(COMMANDED)

    def deviations(calibration: SessionCalibration) -> np.ndarray:
        model, at = calibration.model(outer, rows, names)
        return np.degrees(np.sqrt(np.diagonal(model.covariance(at), axis1=1, axis2=2)[:, 6:]))

    measured, commanded = deviations(known), deviations(replace(known, commanded=COMMANDED))
    np.testing.assert_array_equal(commanded[0], measured[0])
    np.testing.assert_allclose(commanded[1, 0], np.hypot(measured[1, 0], 10 * np.degrees(0.2) / 30), rtol=1e-9)
    np.testing.assert_allclose(commanded[2], np.hypot(measured[2], [0, 10, 0]), rtol=1e-9)
