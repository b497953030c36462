"""The margin of a session's masks: found, stated and taken off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np
import pytest
from helpers.session_worlds import PRIOR, SEEN, World, make_frames_in_memory, make_world

from dvrk_cmaes import Body, FrameData, SessionCalibration, SessionFrame, calibrate_session
from dvrk_cmaes.calibration.constants import Constant, FramesAt, SessionOutlines
from dvrk_cmaes.calibration.session_camera import CameraChange, file_deviations
from dvrk_cmaes.calibration.session_masks import MARGIN, Margin, MaskMargin, SessionMasks, estimate_margin
from dvrk_cmaes.calibration.session_state import Imaging
from dvrk_cmaes.calibration.solve import FrameFits
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.term import Quadratic

FRAMES = 10


def grown(frame: SessionFrame, pixels: int) -> SessionFrame:
    """Give a frame whose mask has a margin of some pixels, negative for a mask that is too narrow."""
    assert isinstance(frame.data, FrameData)
    change = cv2.dilate if pixels > 0 else cv2.erode
    mask = change(frame.data.mask.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=abs(pixels)) > 0
    return replace(frame, data=FrameData.of(mask, frame.data.camera))


@pytest.fixture(scope="module")
def calibrations(bundled_body: Body) -> dict[int, tuple[SessionCalibration, float]]:
    """Calibrations by margin, px, with the distances of their bases from the true one, mm."""
    base, _, frames = make_frames_in_memory(bundled_body, FRAMES, level="clean")
    solved = {}
    for pixels in (-1, 0, 1):
        own = [grown(frame, pixels) for frame in frames] if pixels else frames
        calibration = calibrate_session(own, bundled_body).calibration
        off = 1e3 * np.linalg.norm(calibration.camera_from_base[:3, 3] - base[:3, 3])
        solved[pixels] = calibration, float(off)
    return solved


@pytest.mark.parametrize("pixels", [-1, 1])
def test_margin_is_found_and_taken_off(calibrations: dict[int, tuple[SessionCalibration, float]], pixels: int) -> None:
    masks = calibrations[pixels][0].masks
    assert masks is not None
    assert masks.applied
    assert masks.margin_px == pytest.approx(pixels, abs=0.3)
    assert masks.std_margin_px < 0.3
    assert calibrations[pixels][1] < 1.0


def test_exact_masks_are_left_as_they_are(calibrations: dict[int, tuple[SessionCalibration, float]]) -> None:
    masks = calibrations[0][0].masks
    assert masks is not None
    assert not masks.applied
    assert masks.taken_off == 0
    assert abs(masks.margin_px) < 0.15


def test_margin_is_described_in_words() -> None:
    assert SessionMasks(0.4, 0.1, applied=True).describe() == (
        "masks are 0.40 px (std 0.10) too wide all round; taken off"
    )
    assert "0.05 px (std 0.10) too narrow all round; left as they are" in SessionMasks(-0.05, 0.1, False).describe()


@dataclass(frozen=True, eq=False)
class FarCamera:
    """Outlines of a session that fit a focal length 10 % shorter than the file's and masks 0.8 px too wide."""

    world: World
    constants: tuple[Constant, ...] = (CameraChange(file_deviations(SessionConfig())), MaskMargin())

    def near(self, at: Posed, constants: Mapping[str, np.ndarray]) -> FrameFits:
        """Linearise the outlines as `SessionOutlines.near`: a longer focal length looks like a depth.

        A margin moves what is seen to alternate sides, so that it is told.
        """
        depth = self.world.at.pose[:, 2, 3]
        jacobian = np.zeros((len(depth), len(SEEN), len(SEEN) + 4))
        jacobian[:] = np.eye(len(SEEN), len(SEEN) + 4)
        jacobian[:, 2, -4], jacobian[:, 0, -1] = depth, 1e-3 * (-1.0) ** np.arange(len(depth))
        jacobian[:, 0, -3] = jacobian[:, 1, -2] = depth / 1000
        off = np.array([-0.1, 0.0, 0.0, 0.8]) - np.concatenate([*constants.values()])
        seen = self.world.at.minus(at) + jacobian[:, :, -4:] @ off
        weighted = np.swapaxes(jacobian, 1, 2) * (0.1 * SEEN) ** -2
        return FrameFits(at, Quadratic(weighted @ jacobian, -(weighted @ seen[:, :, None])[:, :, 0]), constants)


def test_poses_with_a_margin_are_those_with_the_camera_of_the_file() -> None:
    """A change of the camera that is estimated beside it is not used: poses with that would be centimetres off."""
    world = make_world(80)
    outlines = cast("SessionOutlines", FarCamera(world))
    margin, _, at = estimate_margin(FramesAt(world.model, world.truth, PRIOR, world.at), outlines)
    assert margin.applied
    constants = {"camera": np.zeros(3), MARGIN: np.array([margin.px])}
    with_file = FarCamera(world).near(at, constants).at_constants()
    off = 1e3 * np.abs(with_file.optimum(np.zeros(0))[:, 2])
    assert np.quantile(off, 0.9) < 1.5


def test_arms_share_the_margins_of_their_masks_and_the_camera() -> None:
    """Each is the mean by the standard deviations; a margin that two arms tell together is taken off."""
    one = Imaging(np.array([0.01, 2.0, 0.0]), np.diag([1e-4, 4.0, 4.0]), margins=(("left", Margin.of(0.3, 0.15)),))
    other = Imaging(np.array([0.03, 4.0, 0.0]), np.diag([1e-4, 1.0, 4.0]), margins=(("left", Margin.of(0.36, 0.12)),))
    assert not one.margins[0][1].applied
    both = one.with_others([other])
    ((view, margin),) = both.margins
    assert view == "left"
    assert margin.px == pytest.approx((0.3 / 0.15**2 + 0.36 / 0.12**2) / (0.15**-2 + 0.12**-2))
    assert margin.applied
    assert both.change is not None
    assert both.of_change is not None
    np.testing.assert_allclose(both.change, [0.02, 3.6, 0.0])
    np.testing.assert_allclose(np.diag(both.of_change), [0.5e-4, 0.8, 2.0])
    assert one.with_others([Imaging()]).change is one.change
