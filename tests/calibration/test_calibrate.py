"""Calibration of a session from its frames' masks: base, offsets, covariances, frames left out and refused sessions."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from helpers.session_worlds import Truth, in_other_mode, make_frames_in_memory, tip_mm, with_result
from helpers.transforms import apply, moved, rotation_angle

from dvrk_cmaes import (
    Body,
    EstimateConfig,
    FrameData,
    InputError,
    Result,
    SessionFrame,
    SolvedSession,
    calibrate_session,
)

ROUGH = replace(EstimateConfig(), session=replace(EstimateConfig().session, test_camera=False))
"""Settings for tests of other things than the camera."""


@dataclass(frozen=True)
class Made:
    """A synthetic session with its truth and its calibration."""

    body: Body
    base: np.ndarray
    truths: list[Truth]
    frames: list[SessionFrame]
    solved: SolvedSession
    stages: list[tuple[str, int]]

    def tip_mm(self, result: Result, index: int) -> float:
        return tip_mm(result, self.truths[index])


def stray_of(frames: list[SessionFrame], index: int, other: SessionFrame) -> None:
    """Replace a frame's mask and estimate by those of another session's frame; its readings stay."""
    mine = frames[index]
    assert mine.name != other.name or mine is not other
    result = replace(other.result, frame=mine.name, readings=mine.result.readings)
    frames[index] = replace(mine, data=other.data, result=result)


@pytest.fixture(scope="module")
def made(bundled_body: Body) -> Made:
    """Eight frames: two estimated in the mirror twin's mode, one with mask and result of another session."""
    base, truths, frames = make_frames_in_memory(bundled_body, 8, level="clean")
    others = make_frames_in_memory(bundled_body, 8, level="clean", seed=11)[2]
    for i in (1, 4):
        frames[i] = in_other_mode(frames[i])
    stray_of(frames, 6, others[6])
    stages: list[tuple[str, int]] = []
    solved = calibrate_session(
        frames,
        bundled_body,
        config=EstimateConfig(),
        progress=lambda stage, count: stages.append((stage, count)),
    )
    return Made(bundled_body, base, truths, frames, solved, stages)


# the calibration


def test_scatter_of_the_readings_is_estimated_by_joint(bundled_body: Body) -> None:
    frames, rng = make_frames_in_memory(bundled_body, 10, level="clean")[2], np.random.default_rng(0)
    noised = []
    for frame in frames:
        readings = dict(frame.result.readings)
        readings["wrist_yaw"] += np.radians(12) * rng.standard_normal()
        noised.append(with_result(frame, readings=readings))
    plain, noisy = (rough(bundled_body, each).calibration.spreads for each in (frames, noised))
    assert noisy["wrist_yaw"] > 2 * plain["wrist_yaw"]
    assert noisy["wrist_pitch"] < 1.5 * plain["wrist_pitch"]
    assert np.degrees(plain["wrist_yaw"]) < 3.0  # those of the level are exact


def test_frames_near_each_other_in_time_count_less_as_their_masks_err_alike(bundled_body: Body) -> None:
    frames = make_frames_in_memory(bundled_body, 8)[2]

    def std(interval: float) -> np.ndarray:
        timed = [replace(frame, time=k * interval) for k, frame in enumerate(frames)]
        return np.sqrt(np.diag(rough(bundled_body, timed).calibration.covariance)[:6])

    assert (std(0.03) > 1.4 * std(3.0)).all()


def test_left_out_frame_keeps_its_pose_and_is_doubtful(made: Made) -> None:
    before, after = made.frames[6].result, made.solved.results["0006"]
    assert after.status == "doubtful"
    assert after.reasons[-1] == made.solved.calibration.left_out["0006"]
    assert (after.source, after.change) == ("frame", None)
    assert after.camera_from_root is before.camera_from_root


# the frames


def test_calibrated_frames_are_in_the_true_mode(made: Made) -> None:
    for i, (truth, result) in enumerate(zip(made.truths, made.solved.results.values(), strict=True)):
        if i == 6:
            continue
        assert result.source == "session"
        assert result.camera_from_root is not None
        assert np.degrees(rotation_angle(result.camera_from_root, truth.camera_from_root)) < 15
        assert made.tip_mm(result, i) < 1.0


# faulty sessions, found before outlines are used


def rough(body: Body, frames: list[SessionFrame], **options: Any) -> SolvedSession:
    return calibrate_session(frames, body, config=ROUGH, **options)


def refusal(body: Body, frames: list[SessionFrame], **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        rough(body, frames, **options)
    text = str(caught.value)
    assert "\n" not in text
    return text


def without_readings(frame: SessionFrame, *names: str) -> SessionFrame:
    kept = {name: value for name, value in frame.result.readings.items() if name not in names}
    return with_result(frame, readings=kept)


def failed(frame: SessionFrame) -> SessionFrame:
    reasons = ("mask: empty",)
    return with_result(frame, status="failed", reasons=reasons, camera_from_root=None, joints={}, covariance=None)


def test_fewer_than_three_usable_frames_are_refused(made: Made) -> None:
    assert refusal(made.body, made.frames[:2]) == (
        "session: expected at least 3 usable frames, got 2 (no more were given)"
    )
    two_left = [failed(made.frames[0]), without_readings(made.frames[2], "yaw"), *made.frames[3:5]]
    assert refusal(made.body, two_left) == (
        "session: expected at least 3 usable frames, got 2 "
        "(no pose: mask: empty; no readings of all outer joints (yaw, pitch, insertion, roll))"
    )


def test_frames_without_outer_readings_or_pose_are_left_out(made: Made) -> None:
    frames = [*made.frames[:4], without_readings(made.frames[5], "insertion", "roll"), failed(made.frames[7])]
    solved = rough(made.body, frames)
    assert solved.calibration.left_out == {
        "0005": "no readings of all outer joints (yaw, pitch, insertion, roll)",
        "0007": "no pose: mask: empty",
    }
    assert solved.calibration.status == "ok"
    assert solved.results["0005"].to_dict() == frames[4].result.to_dict()
    assert solved.results["0007"].to_dict() == frames[5].result.to_dict()


def test_frames_without_common_base_are_refused(bundled_body: Body) -> None:
    frames = [make_frames_in_memory(bundled_body, 1, level="clean", seed=seed)[2][0] for seed in range(20, 24)]
    frames = [replace(one, name=f"{k}") for k, one in enumerate(frames)]
    text = refusal(bundled_body, frames)
    assert text.startswith("session: expected at least 3 frames that agree on where the arm's base is, got ")
    named = text[text.index(" of 4 (") + len(" of 4 (") : text.index("): try another --instrument")].split("; ")
    assert 2 <= len(named) <= 4
    assert all(
        re.match(r"[0-3] (\d+\.\d times the expected error|what it expects does not explain)", one) for one in named
    )


def test_base_supported_by_minority_gives_warning(bundled_body: Body, made: Made) -> None:
    strange = [make_frames_in_memory(bundled_body, 1, level="clean", seed=seed)[2][0] for seed in range(20, 24)]
    frames = [*(made.frames[i] for i in (0, 2, 3)), *(replace(one, name=f"x{k}") for k, one in enumerate(strange))]
    solved = rough(bundled_body, frames)
    assert solved.calibration.doubts == (
        "only 3 of 7 frames agree on where the arm's base is: "
        "the others' masks or the readings are wrong, or these few are",
    )
    assert solved.calibration.status == "doubtful"
    assert solved.calibration.frames == ("0000", "0002", "0003")


def test_readings_without_motion_are_refused(made: Made) -> None:
    still = {name: made.frames[0].result.readings[name] for name in ("yaw", "pitch", "insertion", "roll")}
    frames = [with_result(one, readings={**one.result.readings, **still}) for one in made.frames]
    assert refusal(made.body, frames) == (
        "session: yaw, pitch, insertion, roll: expected readings of an arm that moves, got the same in all frames"
    )


def test_moved_base_gives_warning_and_each_part_has_its_base(bundled_body: Body, made: Made) -> None:
    there, _, others = make_frames_in_memory(bundled_body, 5, level="clean", seed=11)
    before = [one for i, one in enumerate(made.frames) if i != 6]
    after = [replace(one, name=f"1{one.name}") for one in others[:4]]
    solved = rough(bundled_body, before + after)
    text = "the arm's base or the camera moved between frames 0007 and 10000"
    assert solved.calibration.remarks == (f"{text}: 2 bases, and all else is shared",)
    assert solved.calibration.endoscope is not None
    for stand, base in zip(solved.calibration.endoscope.bases, (made.base, there), strict=True):
        assert 1e3 * np.linalg.norm(stand.camera_from_base[:3, 3] - base[:3, 3]) < 6


def test_frames_that_are_wrong_alike_are_no_move_of_the_base(bundled_body: Body) -> None:
    """Consecutive frames whose own poses are wrong by one motion agree on a base; their masks show another one."""
    _, truths, frames = make_frames_in_memory(bundled_body, 12, level="clean")
    wrong = moved(np.eye(4), [0.004, 0.0, -0.022, 0.0, 0.05, 0.0])
    for i in range(4, 8):
        pose = frames[i].result.camera_from_root
        assert pose is not None
        frames[i] = with_result(frames[i], camera_from_root=wrong @ pose, alternatives=())
    solved = rough(bundled_body, frames)
    assert solved.calibration.endoscope is None
    assert solved.calibration.remarks == ()
    ok = [(truth, one) for truth, one in zip(truths, solved.results.values(), strict=True) if one.status == "ok"]
    assert len(ok) > 5
    for truth, result in ok:
        tips = apply(truth.camera_from_root, bundled_body.instrument.tips(truth.values))
        assert np.linalg.norm(np.array(result.tips) - tips, axis=1).mean() < 3e-3


def test_roll_offset_is_undetermined_without_rotation(bundled_body: Body) -> None:
    _, truths, frames = make_frames_in_memory(bundled_body, 4, level="clean")
    # the arm only moves along the insertion axis, in the readings and in the poses
    first = truths[0]
    slid = []
    for k, one in enumerate(frames):
        assert isinstance(one.data, FrameData)
        reading = {**frames[0].result.readings}
        reading["insertion"] += 0.002 * k
        pose = first.camera_from_root.copy()
        pose[:3, 3] += 0.002 * k * pose[:3, 2]
        joints = dict(first.joints)
        slid.append(with_result(one, readings=reading, camera_from_root=pose, joints=joints, alternatives=()))
        slid[-1] = replace(slid[-1], data=frames[0].data)
    solved = rough(bundled_body, slid)
    assert any(text.startswith("rotation of the base: standard deviation") for text in solved.calibration.undetermined)
    assert any("cannot be distinguished from the offset of roll" in text for text in solved.calibration.undetermined)
    assert abs(np.degrees(solved.calibration.offsets["roll"])) < 20
