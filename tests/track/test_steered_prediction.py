"""What is expected of images where the endoscope moves, and the readings of its arm in the buffer of a tracker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import BASE, NAMES, OFFSETS, make_world

from dvrk_cmaes import InputError, SessionCalibration
from dvrk_cmaes.calibration.blocks import BASE_AXES, OUTER_OFFSETS
from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.prediction import Prediction, endoscope_at
from dvrk_cmaes.calibration.session_endoscope import SessionEndoscope
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.track.reading_buffer import ReadingBuffer

READ = np.repeat([[0.1, 0.05, 0.12, 0.2], [0.2, -0.05, 0.13, 0.1]], 5, axis=0)


@pytest.fixture(scope="module")
def calibration() -> SessionCalibration:
    """A calibration of ten frames at two places of the endoscope."""
    steered = Steered.of(READ)
    assert steered is not None
    model = replace(make_world(10).model, endoscope=steered)
    values = steered.start.changed(np.full(len(steered.start.std), 0.01))
    solution = model.calibration(BASE, OFFSETS).with_blocks(endoscope=values)
    covariance = 1e-6 * np.eye(solution.own)
    names = (*OUTER_OFFSETS, *NAMES)
    spreads = dict.fromkeys(("yaw", "pitch", "insertion", "roll", *NAMES, "slack_translation", "slack_rotation"), 1e-3)
    frames = [f"{k}" for k in range(10)]
    return SessionCalibration(
        instrument="lnd",
        camera_from_base=BASE,
        offsets=dict(zip(names, OFFSETS.tolist(), strict=True)),
        axes=(*BASE_AXES, *names),
        covariance=covariance[:11, :11],
        covariance_given_camera=covariance[:11, :11],
        spreads=spreads,
        endoscope=SessionEndoscope.of(model, solution, covariance, frames, [0.1 * k for k in range(10)]),
    )


def test_images_are_expected_by_the_base_of_their_place(calibration: SessionCalibration) -> None:
    model = make_world(10).model
    for k in (1, 7):
        of_image = calibration, model.outer[[k]], model.joints[[k]], NAMES
        found = Prediction.of(*of_image, endoscope=endoscope_at(calibration, None, READ[k]))
        there = calibration.at(dict(zip(ECM_JOINTS, READ[k].tolist(), strict=True)))
        assert isinstance(there, SessionCalibration)
        alone = Prediction.of(there, *of_image[1:])
        np.testing.assert_allclose(found.at.pose, alone.at.pose, atol=1e-12)
        np.testing.assert_allclose(found.spread, alone.spread, atol=1e-12)


def test_without_readings_of_the_endoscope_its_place_is_not_known(calibration: SessionCalibration) -> None:
    model = make_world(10).model
    assert endoscope_at(calibration, None, None) is None
    found = Prediction.of(calibration, model.outer[:1], model.joints[:1], NAMES)
    assert found.jacobian.shape[2] == len(calibration.whole_covariance)


def test_buffer_holds_the_latest_readings_of_the_endoscopes_arm() -> None:
    buffer = ReadingBuffer(NAMES, 0.2, 1.0)
    arm = dict(zip(("yaw", "pitch", "insertion", "roll"), (0.1, 0.2, 0.1, 0.3), strict=True))
    for k in range(5):
        buffer.add(0.1 * k, arm)
    assert buffer.at(0.25).ecm is None
    for k in range(0, 5, 2):
        buffer.add(0.1 * k, dict(zip(ECM_JOINTS, (0.1 * k, 0.0, 0.1, 0.0), strict=True)))
    assert buffer.at(0.1).ecm == pytest.approx([0.1, 0.0, 0.1, 0.0])
    assert buffer.at(9.0).ecm == pytest.approx([0.4, 0.0, 0.1, 0.0])
    assert buffer.at(0.25).outer == pytest.approx(list(arm.values()))
    with pytest.raises(InputError, match="ecm_insertion: expected metres"):
        buffer.add(0.5, {"ecm_insertion": 120.0})
