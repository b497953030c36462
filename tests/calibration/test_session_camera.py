"""Test of a session's camera: the change that its frames fit, what contradicts the file, and the corrected camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import EXPECTED_OFFSETS, SMALL, make_frames_in_memory
from helpers.transforms import change_between

from dvrk_cmaes import Body, EstimateConfig, FrameData, SessionFrame
from dvrk_cmaes.calibration.autocorrelated_errors import CommonErrors
from dvrk_cmaes.calibration.blocks import Calibration
from dvrk_cmaes.calibration.linearise import ArmOutlines, SessionOutlines
from dvrk_cmaes.calibration.model import Deviations, SessionModel, outer_readings
from dvrk_cmaes.calibration.session_camera import CameraChange, CameraCheck, SessionCamera, check_camera
from dvrk_cmaes.calibration.session_masks import MaskMargin
from dvrk_cmaes.calibration.solve import FrameFits, Solved, solve
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.io.typed_document import convert_document
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.synth.truth import Truth

FRAMES = 10
CONFIG = SessionConfig()
FILE = np.array([0.005, 3.0, 3.0])  # standard deviations

Made = tuple[np.ndarray, list[Truth], list[SessionFrame]]


@pytest.fixture(scope="module")
def made(bundled_body: Body) -> Made:
    """Base, truth and frames of a session, whose masks are those of the camera `SMALL`."""
    return make_frames_in_memory(bundled_body, FRAMES, level="clean")


def check(
    body: Body, made: Made, focal_scale: float, *, insertion: float = 1.0, config: SessionConfig = CONFIG
) -> tuple[CameraCheck, Solved]:
    """Check a file whose focal length is the true one divided by ``focal_scale``, from poses as seen with that file.

    The readings of insertion are scaled about their mean by ``insertion``.
    """
    base, truths, frames = made
    wrong = SMALL.changed(1 / focal_scale, (0.0, 0.0))
    names = body.instrument.joint_names
    readings = tuple(one.result.readings for one in frames)
    poses = np.array([one.camera_from_root for one in truths])
    poses[:, 2, 3] /= focal_scale
    joints = np.array([one.values for one in truths])
    at, stored = Posed(poses, joints), []
    for k, one in enumerate(frames):
        assert isinstance(one.data, FrameData)
        stored.append(StoredFrame.of(one.data.with_camera(wrong), at[k], body, EstimateConfig()))
    outlines = SessionOutlines(
        stored,
        [0] * len(frames),
        lambda function, tasks: [function(body, EstimateConfig(), task) for task in tasks],
        CommonErrors(np.full(len(frames), np.nan), np.zeros((len(frames), 6 + len(names)))),
        (CameraChange(), MaskMargin()),
    )
    outer = outer_readings(readings)
    outer[:, 2] = outer[:, 2].mean() + insertion * (outer[:, 2] - outer[:, 2].mean())
    read = np.array([[one[name] for name in names] for one in readings])
    model = SessionModel(outer, read, names, Deviations.of(CONFIG, names), roll_offset=body.instrument.roll_offset)
    of_camera = outlines.near(at, {one.name: one.start for one in outlines.blocks}).outlines
    fits = FrameFits(at, Quadratic(of_camera.information[:, :-4, :-4], of_camera.slope[:, :-4]))
    solution = solve(model, fits, Calibration.of(base, np.zeros(len(EXPECTED_OFFSETS)), EXPECTED_OFFSETS))
    arm = ArmOutlines(model, solution.calibration, at, outlines)
    return check_camera([arm], EstimateConfig(session=config))[0], solution


def found_camera(
    change: tuple[float, float, float], std: tuple[float, float, float], *, applied: bool = False
) -> SessionCamera:
    return SessionCamera.of(np.array(change), np.diag(np.square(std)), FILE, 640, applied=applied)


@pytest.mark.parametrize(("change", "contradicts"), [(0.1, True), (0.02, False)])
def test_file_is_contradicted_by_a_change_beyond_its_errors_and_those_of_the_frames(
    change: float, contradicts: bool
) -> None:
    assert found_camera((change, 0.0, 0.0), (0.02, 5.0, 5.0)).contradicts == contradicts


# the change that frames fit


@pytest.mark.parametrize("focal_scale", [0.9, 1.1])
def test_focal_length_ten_percent_off_is_found_and_named(bundled_body: Body, made: Made, focal_scale: float) -> None:
    found = check(bundled_body, made, focal_scale)[0].camera
    assert found is not None
    assert found.contradicts
    assert not found.applied
    assert found.focal_scale == pytest.approx(focal_scale, abs=max(0.02, 2 * found.std_focal_scale))
    assert found.std_focal_scale < 0.03
    (text,) = found.contradictions()
    than = "longer" if focal_scale > 1 else "shorter"
    assert text.startswith("the camera file is contradicted: these frames fit a focal length ")
    assert f" {than}" in text
    assert "principal point" not in text


def test_right_camera_is_not_contradicted(bundled_body: Body, made: Made) -> None:
    found = check(bundled_body, made, 1.0)[0].camera
    assert found is not None
    assert not found.contradicts
    assert found.contradictions() == []
    assert found.focal_scale == pytest.approx(1.0, abs=3 * found.std_focal_scale)
    assert found.std_focal_scale <= 0.005
    assert max(found.std_principal_point_px) <= 0.003 * SMALL.fx + 0.1


def test_few_frames_and_still_insertion_do_not_test_the_camera(bundled_body: Body, made: Made) -> None:
    base, truths, frames = made
    few, _ = check(bundled_body, (base, truths[:5], frames[:5]), 1.0)
    assert few.camera is None
    assert few.undetermined == "camera: 5 frames; at least 6 are needed to test its focal length"
    assert np.linalg.matrix_rank(few.covariance) == 3  # the errors of the file are expected all the same
    still, _ = check(bundled_body, made, 1.0, insertion=0.01)
    assert still.camera is None
    assert still.undetermined.endswith(" mm; at least 5 mm are needed to test its focal length")


def test_camera_is_not_tested_where_the_settings_say_so(bundled_body: Body, made: Made) -> None:
    untested, _ = check(bundled_body, made, 1.1, config=replace(CONFIG, test_camera=False))
    assert untested.camera is None
    assert untested.undetermined == "camera: not tested, as the settings say"
    assert np.linalg.matrix_rank(untested.covariance) == 3  # the errors of the file are expected all the same


@pytest.mark.parametrize("focal_scale", [0.98, 1.1])
def test_covariance_covers_what_a_wrong_camera_does_to_the_base(
    bundled_body: Body, made: Made, focal_scale: float
) -> None:
    found, solution = check(bundled_body, made, focal_scale)
    off = change_between(made[0], solution.calibration.camera_from_base)
    alone, with_camera = solution.covariance[:6, :6], (solution.covariance + found.covariance)[:6, :6]
    assert off @ np.linalg.solve(alone, off) > 6 * 3**2
    assert off @ np.linalg.solve(with_camera, off) < 6 * 2.5**2


# the decision


def test_file_counts_as_measurement_where_it_is_not_contradicted() -> None:
    found = found_camera((0.02, 0.0, 0.0), (0.1, 100.0, 100.0))
    assert not found.contradicts
    assert 1.0 < found.focal_scale < 1.001
    assert found.std_focal_scale == pytest.approx(0.005, rel=0.01)
    assert found.std_principal_point_px == pytest.approx((3.0, 3.0), rel=0.01)


def test_principal_point_far_off_is_named_with_its_direction() -> None:
    found = found_camera((0.0, -70.0, 2.0), (0.005, 2.0, 2.0))
    (text,) = found.contradictions()
    assert "a principal point 70 px (std 2) left and 2 px (std 2) down" in text
    assert "focal length" not in text.split(";")[0]


# the corrected camera and the document


def test_document_is_read_back() -> None:
    found = found_camera((0.1, 20.0, -10.0), (0.005, 2.0, 2.0), applied=True)
    document = found.to_dict()
    again = convert_document("session.json", document, SessionCamera)
    assert again.to_dict() == document
