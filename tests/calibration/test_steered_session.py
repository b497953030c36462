"""Sessions of masks whose endoscope was steered: with readings of its arm and without, each frame has its own base."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from helpers.session_worlds import SMALL, near_the_truth, with_result
from helpers.transforms import change_between

from dvrk_cmaes import (
    Body,
    EstimateConfig,
    FrameData,
    SessionCalibration,
    SessionFrame,
    SolvedSession,
    calibrate_session,
)
from dvrk_cmaes.calibration.calibrate import begin_arm, in_threads
from dvrk_cmaes.calibration.endoscope import in_tip
from dvrk_cmaes.calibration.session_problem import ArmSetup
from dvrk_cmaes.calibration.together import (
    Begun,
    RelativeBase,
    arms_document,
    relative_bases,
    solved_together,
)
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.moving_arm import MOTION_LEVELS
from dvrk_cmaes.synth.recording import RecordedArm, record_arm
from dvrk_cmaes.synth.scene import exact_mask
from dvrk_cmaes.synth.session import SessionPlan

FRAMES = 12
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
        mask = exact_mask(SMALL, arm.truths[k])
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


@pytest.fixture(scope="module")
def alone(bundled_body: Body, world: tuple[RecordedArm, list[SessionFrame]]) -> SolvedSession:
    """The session of one arm."""
    return calibrate_session(world[1], bundled_body, config=QUICK)


def test_camera_in_the_tip_and_bases_are_found(
    world: tuple[RecordedArm, list[SessionFrame]], alone: SolvedSession
) -> None:
    arm, frames = world
    assert arm.steering is not None
    solved, found = alone, alone.calibration.endoscope
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


def setup_of(body: Body) -> ArmSetup:
    return ArmSetup(None, body.instrument, "classic", QUICK, partial(in_threads, body, QUICK))


def test_arms_in_one_solution_share_the_endoscope(
    bundled_body: Body, world: tuple[RecordedArm, list[SessionFrame]], alone: SolvedSession
) -> None:
    """Half of the frames as those of another arm: both tell the endoscope better than one, and how the bases lie."""
    _, frames = world

    def begin(own: list[SessionFrame]) -> Begun[SolvedSession]:
        return begin_arm(own, setup_of(bundled_body)).then(lambda found: found[0])

    both = solved_together({"PSM1": partial(begin, frames), "PSM2": partial(begin, frames[1::2])})
    found = {name: solved.calibration for name, solved in both.items()}
    first, second, single = (own.endoscope for own in (found["PSM1"], found["PSM2"], alone.calibration))
    assert first is not None
    assert second is not None
    assert single is not None
    assert second.places[0].readings == first.places[0].readings
    for both_tell in (first, second):
        assert np.mean(both_tell.std_tip_from_camera) < 0.95 * np.mean(single.std_tip_from_camera)
    bases = relative_bases(found)
    document = arms_document(found, bases, {})
    off = change_between(np.eye(4), bases["PSM2"].reference_from_base)  # in truth, they are one arm
    std = np.sqrt(np.diag(bases["PSM2"].covariance))
    assert (np.abs(off) < 3 * std).all()
    without = RelativeBase.between(found["PSM1"], found["PSM2"], np.zeros((6, 6)))
    assert (std <= np.sqrt(np.diag(without.covariance))).all()
    assert list(document["endoscope"]["arms"]) == ["PSM1", "PSM2"]


def test_an_arm_with_another_camera_in_the_tip_keeps_its_own(
    bundled_body: Body, world: tuple[RecordedArm, list[SessionFrame]]
) -> None:
    """The readings of the endoscope's roll joint are 40 deg off for one arm."""
    _, frames = world
    roll = {one.name: one.result.readings["ecm_roll"] + 0.7 for one in frames}
    off = [with_result(one, readings={**one.result.readings, "ecm_roll": roll[one.name]}) for one in frames]
    both = solved_together(
        {
            name: lambda own=own: begin_arm(own, setup_of(bundled_body)).then(lambda found: found[0])
            for name, own in (("PSM1", frames), ("PSM2", off[::2]))
        }
    )
    first, second = (solved.calibration.endoscope for solved in both.values())
    assert first is not None
    assert second is not None
    assert first.tip_from_camera is not None
    assert any("another camera in the endoscope's tip" in text for text in both["PSM2"].calibration.remarks)


def test_without_readings_each_piece_has_its_base(
    bundled_body: Body, world: tuple[RecordedArm, list[SessionFrame]]
) -> None:
    arm, frames = world
    without = [without_ecm(frame) for frame in frames]
    solved = calibrate_session(without, bundled_body, config=QUICK)
    # an arm whose frames tell the same moves makes the bases better known
    both = solved_together(
        {name: lambda: begin_arm(without, setup_of(bundled_body)).then(lambda found: found[0]) for name in ("1", "2")}
    )
    std, std_of_both = (
        np.sqrt(np.diag(one.calibration.endoscope.covariance))[-18:]
        for one in (solved, both["1"])
        if one.calibration.endoscope is not None
    )
    assert np.mean(std_of_both / std) < 0.95
    found = solved.calibration.endoscope
    assert found is not None
    assert found.tip_from_camera is None
    assert len(found.bases) == 4
    assert any("moved between frames" in text for text in solved.calibration.remarks)
    errors = base_errors(solved, arm, without)
    assert np.median(errors) < 1.5
