"""Errors that all masks of a session share on some sides: their effect, what is found of them, and what they widen."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory
from helpers.transforms import apply

from dvrk_cmaes import Body, FrameData, SessionCalibration, SessionFrame, calibrate_session
from dvrk_cmaes.calibration.autocorrelated_errors import SINGLE
from dvrk_cmaes.calibration.frame_fit import outline_and_masks
from dvrk_cmaes.calibration.session_masks import changes_by_masks
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.evidence.outline_noise import OutlineNoise
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.shared_errors import image_axis
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.track.frame_fits import views_that_show

RIGHT = 2
"""Index of what faces right in the image."""

INFORMATION = np.diag([1 / 0.001**2] * 3 + [1 / 0.02**2] * 6)
"""What is known of a pose beside an outline."""


def shadowed(frame: SessionFrame, pixels: int) -> SessionFrame:
    """Give a frame whose mask has a shadow on its right side, some pixels wide."""
    assert isinstance(frame.data, FrameData)
    mask = frame.data.mask.astype(np.uint8)
    moved = cv2.warpAffine(mask, np.array([[1.0, 0.0, pixels], [0.0, 1.0, 0.0]]), mask.shape[::-1])
    return replace(frame, data=FrameData.of((mask | moved) > 0, frame.data.camera))


def near_truth(body: Body, pixels: int) -> tuple[Quadratic, np.ndarray]:
    """Give the outline's terms at the true pose of a frame with shadows of some width, and what masks' errors do."""
    _, truths, frames = make_frames_in_memory(body, 3, level="clean", seed=11)
    at, data = Posed(truths[0].camera_from_root, truths[0].values), shadowed(frames[0], pixels).data
    assert isinstance(data, FrameData)
    (view,) = views_that_show(data.views, body)
    outline = OutlineConfig()
    coverage = Coverage([SizedView(view, blur=outline.blur)], outline, noise=1.0)
    return outline_and_masks(coverage, at, [OutlineNoise(1.0, 19.0)], SINGLE, None, as_seen=True)


def test_errors_of_masks_change_what_an_outline_tells_as_its_derivative_says(bundled_body: Body) -> None:
    (exact, by_masks), (dark, _) = (near_truth(bundled_body, pixels) for pixels in (0, 1))
    known = exact.information[0] + INFORMATION
    found, told = (
        np.linalg.solve(known, change)[:3] for change in (exact.slope[0] - dark.slope[0], by_masks[:, 1 + RIGHT])
    )
    assert np.linalg.norm(found) > 1e-4
    assert np.linalg.norm(found - told) < 0.5 * np.linalg.norm(found)  # the loss is robust, so not in proportion


@pytest.fixture(scope="module")
def calibrations(bundled_body: Body) -> dict[int, tuple[SessionCalibration, float]]:
    """Calibrations by the width of shadows, px, with the error of the base's origin in standard deviations."""
    base, _, frames = make_frames_in_memory(bundled_body, 10, level="clean")
    solved = {}
    for pixels in (0, 3):
        own = calibrate_session([shadowed(frame, pixels) for frame in frames], bundled_body).calibration
        off = base[:3, :3].T @ (own.camera_from_base[:3, 3] - base[:3, 3])
        solved[pixels] = own, float(np.abs(off / np.sqrt(np.diag(own.covariance)[:3])).max())
    return solved


def test_shadows_are_stated_in_the_masks(calibrations: dict[int, tuple[SessionCalibration, float]]) -> None:
    masks = calibrations[3][0].masks
    assert masks is not None
    assert masks.rms_bias_px[RIGHT] == pytest.approx(max(masks.rms_bias_px), abs=0.01)
    assert masks.rms_bias_px[RIGHT] > 0.2
    assert min(masks.bias_px) >= 0


def test_shadows_widen_what_is_known_and_exact_masks_do_not(
    calibrations: dict[int, tuple[SessionCalibration, float]],
) -> None:
    exact, dark = calibrations[0][0], calibrations[3][0]
    assert exact.masks is not None
    assert dark.masks is not None
    assert max(exact.masks.rms_bias_px) < 0.15
    assert max(dark.masks.rms_bias_px) > 2 * max(exact.masks.rms_bias_px)
    assert np.trace(dark.covariance[:3, :3]) > 1.2 * np.trace(exact.covariance[:3, :3])
    assert calibrations[3][1] < 3


def test_errors_of_masks_move_a_pose_as_they_move_the_outline(bundled_body: Body) -> None:
    """The shaft seems wider by two margins and nearer; an error of one side moves that side alone."""
    _, truths, _ = make_frames_in_memory(bundled_body, 3, level="clean", seed=11)
    at, instrument = Posed(truths[0].camera_from_root, truths[0].values), bundled_body.instrument
    moves = changes_by_masks(at, SMALL, instrument)
    axis = image_axis(instrument, SMALL, at)
    across = np.array([-axis[1], axis[0]])

    def sides(change: np.ndarray) -> np.ndarray:
        """Give the places of both sides of the shaft across it, px, at the instrument's end."""
        seen = at.moved(change)
        end = apply(seen.pose, instrument.ends(seen.joints)).mean(axis=0)
        half = SMALL.fx * instrument.shaft.radius / np.linalg.norm(end) if instrument.shaft is not None else 0.0
        return float(SMALL.project(end[None])[0] @ across) + half * np.array([1.0, -1.0])

    for changed, expected in ((0, [1.0, -1.0]), (1, [1.0, 0.0]), (2, [0.0, -1.0])):
        found = (sides(0.1 * moves[:, changed]) - sides(0.0 * moves[:, 0])) / 0.1
        np.testing.assert_allclose(found, expected, atol=0.15)
    both = moves[:, 3 : 3 + 4] @ np.array([1.0, 1.0, 1.0, 1.0])  # what faces any direction is all that a margin is
    np.testing.assert_allclose(both, moves[:, 0] * np.abs(across).sum(), atol=1e-12)
