"""The margin of a session's masks: found, stated and taken off."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.session_worlds import make_frames_in_memory

from dvrk_cmaes import Body, FrameData, SessionCalibration, SessionFrame, calibrate_session

FRAMES = 8


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
    margin = calibrations[pixels][0].blocks["margin"]
    assert margin.applied
    assert margin.values[0] == pytest.approx(pixels, abs=0.3)
    assert margin.std[0] < 0.3
    assert calibrations[pixels][1] < 1.0


def test_exact_masks_are_nearly_left_as_they_are_and_the_shaft_has_its_radius(
    calibrations: dict[int, tuple[SessionCalibration, float]],
) -> None:
    found = calibrations[0][0]
    margin, parts = found.blocks["margin"], found.blocks["parts"]
    assert found.doubts == ()
    assert abs(parts.values[parts.axes.index("radius")]) < 0.02
    assert abs(margin.values[0]) < 0.05
    assert margin.std[0] < 0.1
