"""A session whose wrist and jaw readings are one constant each: they are commanded, and the session tells the modes."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.session_worlds import Truth, in_other_mode, make_frames_in_memory, with_result
from helpers.transforms import rotation_angle

from dvrk_cmaes import Body, EstimateConfig, SessionFrame, SolvedSession, calibrate_session

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
    return calibrate_session(world[2], bundled_body, config=EstimateConfig())


def test_one_warning_says_that_wrist_readings_never_move(solved: SolvedSession) -> None:
    about = [text for text in solved.calibration.warnings if "never move" in text]
    assert len(about) == 1
    assert about[0].startswith("wrist readings never move: wrist_pitch, wrist_yaw and jaw constant while the arm moves")


def test_the_base_is_found_although_the_wrist_moves_and_its_readings_do_not(
    world: World, solved: SolvedSession
) -> None:
    assert np.degrees(rotation_angle(solved.calibration.camera_from_base, world[0])) < 1.0
    assert 1e3 * np.linalg.norm(solved.calibration.rcm - world[0][:3, 3]) < 1.5


def test_no_frame_whose_mode_the_session_tells_is_doubtful_for_its_twin(world: World, solved: SolvedSession) -> None:
    for frame, truth in zip(world[2], world[1], strict=True):
        result = solved.results[frame.name]
        assert result.camera_from_root is not None
        assert np.degrees(rotation_angle(result.camera_from_root, truth.camera_from_root)) < 5
        assert (result.source, result.mode_probability) == ("session", None)
        assert not [reason for reason in result.reasons if reason.startswith("mode in doubt")]
