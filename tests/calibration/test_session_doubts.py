"""Doubts about a session as a whole, and results that rest on it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.page_calibrations import calibration, solved
from helpers.session_worlds import SMALL, make_frames_in_memory

from dvrk_cmaes import Body, FrameData, SessionCalibration, SessionFrame, TrackResult, calibrate_session
from dvrk_cmaes.calibration.document import Agreement
from dvrk_cmaes.calibration.lag import NO_READINGS_AT_LAG, LagCurve, SessionLag
from dvrk_cmaes.calibration.session_camera import stated_camera
from dvrk_cmaes.calibration.session_doubts import bad_predictions, doubts_of, resting_on
from dvrk_cmaes.camera.fields import WRONG
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.doubts import DISAGREES
from dvrk_cmaes.pose.judge import far_joints
from dvrk_cmaes.synth.truth import Truth

FRAMES = ("0000", "0001", "0002")
BADLY = {"0000": Agreement(0.62, 9.0), "0001": Agreement(0.66, 8.0)}
LONGER = (np.array([np.log(1.2), 0.0, 0.0]), np.diag([0.017, 0.006, 0.007]) ** 2, np.array([0.01, 0.01, 0.01]))
PREDICTS = "this calibration predicts frames badly that it has not seen: IoU 0.64 by the other frames, 0.95 by their "


def session(**fields: Any) -> SessionCalibration:
    return replace(calibration(solved(FRAMES), iou=0.95, leave_one_out={}), **fields)


def with_offset(name: str, value: float, std: float) -> SessionCalibration:
    one = session()
    place = 6 + list(one.offsets).index(name)
    covariance = one.covariance.copy()
    covariance[place, place] = std**2
    return replace(one, offsets={**one.offsets, name: value}, covariance=covariance)


def test_bad_predictions_are_a_doubt() -> None:
    bad = session(leave_one_out=BADLY)
    (text,) = doubts_of(bad)
    assert text == bad_predictions(replace(bad, doubts=(text,)))
    assert text.startswith(PREDICTS)


def test_contours_far_from_predictions_are_a_doubt_in_pixels_that_grow_with_the_image() -> None:
    far = session(leave_one_out=dict.fromkeys(FRAMES, Agreement(0.84, 7.9)))
    (text,) = doubts_of(far, pixel_scale=3.0)
    assert text.startswith("this calibration predicts frames badly that it has not seen: IoU 0.84 by the other frames")
    assert "contour 7.9 px off, expected at most 7.5 px" in text
    for near in (Agreement(0.84, 4.0), Agreement(0.9, 7.9)):  # the second as by errors of the wrist's readings
        assert doubts_of(session(leave_one_out=dict.fromkeys(FRAMES, near)), pixel_scale=3.0) == ()


def test_lag_that_leaves_half_of_the_frames_without_readings_is_a_doubt() -> None:
    (text,) = doubts_of(session(left_out={f"01{k:02d}": NO_READINGS_AT_LAG for k in range(3)}))
    assert text.startswith("the lag leaves 3 of 6 frames without readings")
    assert doubts_of(session(left_out={"0100": NO_READINGS_AT_LAG, "0101": NO_READINGS_AT_LAG})) == ()


def test_few_frames_that_agree_are_a_doubt() -> None:
    left_out = {f"01{k:02d}": f"{DISAGREES}: 5.0 times the expected error" for k in range(4)}
    (text,) = doubts_of(session(left_out=left_out))
    assert text.startswith("only 3 of 7 frames agree on where the arm's base is")


def test_contradicted_camera_is_a_doubt_unless_it_is_put_right() -> None:
    def doubts(applied: bool, factor: float = 1.0) -> tuple[str, ...]:
        found = stated_camera(factor * LONGER[0], *LONGER[1:], SMALL, applied=applied)
        return doubts_of(session(blocks={"camera": found}))

    (text,) = doubts(applied=False)
    assert text.startswith("the camera file is contradicted: these frames fit a focal length 20.0 % (std 2.0) longer")
    assert doubts(applied=True) == ()
    assert doubts(applied=False, factor=0.1) == ()


@pytest.mark.parametrize(
    ("name", "value", "std", "expected"),
    [
        (
            "insertion",
            16.8e-3,
            0.1e-3,
            "offset of insertion: +16.8 mm (std 0.1), where 0.5 mm are usual; likely",
        ),
        ("wrist_yaw", np.deg2rad(24), np.deg2rad(1), "offset of wrist_yaw: +24.0 deg (std 1.0), where 20.0 deg are"),
    ],
)
def test_offset_beyond_what_cables_do_is_a_doubt(name: str, value: float, std: float, expected: str) -> None:
    (text,) = doubts_of(with_offset(name, value, std))
    assert text.startswith(expected)
    assert "another instrument" in text or "an instrument with another shaft" in text


def test_offset_of_roll_is_no_doubt_as_it_is_homed_by_hand() -> None:
    assert doubts_of(with_offset("roll", np.deg2rad(-28), np.deg2rad(1))) == ()


@pytest.mark.parametrize("cut", [False, True])
def test_masks_without_the_ends_of_the_jaws_are_a_doubt(bundled_body: Body, cut: bool) -> None:
    _, truths, frames = make_frames_in_memory(bundled_body, 6)
    seen = [
        replace(frame, data=without_ends(*one)) if cut else frame
        for frame, *one in zip(frames, truths, frames, strict=True)
    ]
    found = calibrate_session(seen, bundled_body).calibration.doubts
    assert [text for text in found if text.startswith("the ends of the jaws are missing from the masks in")] or not cut
    assert cut or not found


def without_ends(truth: Truth, frame: SessionFrame) -> FrameData:
    """Remove from a mask what is within 4 mm of the tips of the jaws."""
    data = frame.data
    assert isinstance(data, FrameData)
    mask = data.mask.copy()
    for tip in truth.tips:
        (u, v), radius = SMALL.project(tip[None])[0], 4e-3 * SMALL.fx / tip[2]
        rows, columns = np.indices(mask.shape)
        mask &= (columns - u) ** 2 + (rows - v) ** 2 > radius**2
    return FrameData.of(mask, data.camera, None)


def test_known_mistake_of_the_camera_file_is_a_doubt_unless_another_camera_is_used() -> None:
    remarks = (f"{WRONG}fx 800 and fy 920 are 13 % apart", "camera file: focal lengths 200 and 200 px")
    assert doubts_of(session(remarks=remarks)) == remarks[:1]
    assert doubts_of(session(remarks=remarks, blocks={"camera": stated_camera(*LONGER, SMALL, applied=True)})) == ()


def test_results_that_rest_on_a_doubtful_session_are_doubtful_for_its_reasons() -> None:
    (good,) = solved(("0000",))
    good = replace(good, status="ok", reasons=(), remarks=("camera file: unusual",), tip_probability=0.9)
    followed = TrackResult(0.0, "ok", (), np.eye(4), {}, None, None, None)
    lost = replace(followed, status="lost", reasons=("lost: the mask is empty",))
    doubtful = session(doubts=("the camera file is contradicted",), remarks=("lag: taken out",))
    of_frame, of_image, of_lost = (resting_on(one, doubtful) for one in (good, followed, lost))
    assert (of_frame.status, of_frame.reasons) == ("doubtful", ("session: the camera file is contradicted",))
    assert of_frame.remarks == ("camera file: unusual", "lag: taken out")
    assert of_frame.tip_probability == pytest.approx(0.6 * 0.9)
    assert (of_image.status, of_image.reasons) == ("doubtful", of_frame.reasons)
    assert (of_lost.status, of_lost.reasons) == ("lost", (*of_frame.reasons, *lost.reasons))


@pytest.mark.parametrize(
    ("off_deg", "expected"),
    [
        ((0.0, 0.0, 0.0), ""),
        ((-4.0, 8.0, 12.0), ""),
        ((0.0, -20.0, -30.0), "jaw is -30 deg from what readings and calibration expect"),
        ((15.0, 0.0, 0.0), "wrist_pitch is +15 deg"),
    ],
)
def test_joints_far_from_what_is_expected_of_an_image_are_a_doubt(
    off_deg: tuple[float, float, float], expected: str
) -> None:
    spread = np.diag(np.radians([1.0] * 6 + [4.0, 8.0, 10.0])) ** 2
    there = Posed(np.eye(4), np.zeros(3))
    found = Posed(np.eye(4), np.radians(off_deg))
    text = "".join(far_joints(found, there, spread, ("wrist_pitch", "wrist_yaw", "jaw")))
    assert expected in text
    assert bool(text) == bool(expected)


@pytest.mark.parametrize(("misfits", "shown"), [([0.24, 0.24, 0.24, 0.24], False), ([0.24, 0.24, 0.2, 0.23], True)])
def test_lag_is_shown_by_frames_that_agree_better_at_it_than_at_none(misfits: list[float], *, shown: bool) -> None:
    assert LagCurve("frames", tuple(enumerate(misfits))).shows(2.2, 60) == shown


@pytest.mark.parametrize(("seconds", "expected"), [(1 / 30, 4.4), (2.0, 15.0)])
def test_frames_of_half_a_second_count_as_one_in_a_lag(seconds: float, expected: float) -> None:
    lag = SessionLag(ReadingSeries("s", {}, {}, {}, seconds), seconds * np.arange(60), True, alike_seconds=0.5)
    assert lag.independent == pytest.approx(expected, 0.02)
