"""The window: what errors that all masks share do to poses that their neighbours and the calibration hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import BASE, NAMES, OFFSETS, SMALL, make_world

from dvrk_cmaes import Body, EstimateConfig, Instrument, SessionCalibration
from dvrk_cmaes.calibration.blocks import BASE_AXES, OUTER_OFFSETS
from dvrk_cmaes.calibration.prediction import Prediction
from dvrk_cmaes.calibration.session_masks import SessionMasks, changes_by_masks
from dvrk_cmaes.track.window import FitEvidence, Window, WindowImage

IMAGES, SIDE = 6, 1
INFORMATION = np.diag([1e6] * 3 + [1e4] * 3 + [1e3] * 3)


def calibration(response: np.ndarray | None, px: float = 0.5) -> SessionCalibration:
    """Make a calibration that is known well but for an error of one side of its masks, and what that did to it."""
    squares = np.zeros((7, 7))
    squares[SIDE, SIDE] = px**2
    masks = SessionMasks(0.0, 0.0, applied=False)
    if response is not None:
        rows = [tuple(map(tuple, matrix.tolist())) for matrix in (squares, response)]
        masks = replace(masks, bias_px=(0.0,) * 6, error_squares=rows[0], by_errors=rows[1])
    names = (*OUTER_OFFSETS, *NAMES)
    spreads = dict.fromkeys(("yaw", "pitch", "insertion", "roll", *NAMES, "slack_translation", "slack_rotation"), 1e-3)
    small = 1e-12 * np.eye(11)
    return SessionCalibration(
        instrument="lnd",
        camera_from_base=BASE,
        offsets=dict(zip(names, OFFSETS.tolist(), strict=True)),
        axes=(*BASE_AXES, *names),
        covariance=small,
        covariance_given_camera=small,
        spreads=spreads,
        masks=masks,
    )


def images(of: SessionCalibration, instrument: Instrument, px: float = 0.0) -> list[WindowImage]:
    """Make images that tell the predicted pose, but for an error of one side of their masks."""
    model = make_world(IMAGES).model
    predicted = Prediction.of(of, model.outer, model.joints, NAMES)
    shown = []
    for k in range(IMAGES):
        by_masks = INFORMATION @ changes_by_masks(predicted.at[k], SMALL, instrument)
        told = FitEvidence(INFORMATION, px * by_masks[:, SIDE], by_masks, 0.0)
        shown.append(WindowImage(0.1 * k, predicted, k, told))
    return shown


def window(of: SessionCalibration, instrument: Instrument) -> Window:
    return Window(of, SMALL, instrument, EstimateConfig())


@pytest.mark.parametrize("only_last", [False, True])
def test_error_of_the_masks_is_in_the_covariance_as_far_as_the_poses_follow_it(
    bundled_body: Body, only_last: bool
) -> None:
    """The covariance that the error adds is that of the distance by which the window moves with it."""
    instrument, response = bundled_body.instrument, np.zeros((11, 7))
    found, without = (
        window(own, instrument).solve(images(own, instrument), only_last=only_last)
        for own in (calibration(response), calibration(response, px=0.0))
    )
    off = window(calibration(response), instrument).solve(images(calibration(response), instrument, 0.5))
    for (at, covariance, _), (_, alone, _), (moved, _, _) in zip(found, without, off[-len(found) :], strict=True):
        change = moved.minus(at)
        np.testing.assert_allclose(covariance - alone, np.outer(change, change), rtol=0.02, atol=1e-10)
        assert np.linalg.norm(change[:3]) > 1e-5


def test_base_that_has_moved_with_the_masks_takes_the_pose_along(bundled_body: Body) -> None:
    """A base that the masks' error moved as it moves the images leaves nothing that holds the pose back."""
    instrument = bundled_body.instrument
    still, along = (np.zeros((11, 7)) for _ in range(2))
    image = images(calibration(still), instrument)[0]
    moves = changes_by_masks(image.at, SMALL, instrument)
    along[:, SIDE] = np.linalg.lstsq(image.predicted.jacobian[0], moves[:, SIDE], rcond=None)[0]
    held, followed = (window(calibration(response), instrument).solve([image])[0][1] for response in (still, along))
    whole = 0.25 * np.outer(moves[:, SIDE], moves[:, SIDE])
    assert np.trace((followed - held)[:3, :3]) > 0
    assert np.trace(held[:3, :3]) < np.trace(whole[:3, :3]) + np.trace(image.predicted.prior[0][:3, :3])
    assert np.trace(followed[:3, :3]) > np.trace(whole[:3, :3])
