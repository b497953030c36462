"""Masks of two eyes that are too wide by different margins: each loses its own where a recording is followed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from helpers.moving_worlds import SMALL, moving_world
from helpers.transforms import transform

from dvrk_cmaes import Body, Camera, EstimateConfig, FrameData, Rig
from dvrk_cmaes.calibration.session_masks import SessionMasks, ViewMargin, margins_of
from dvrk_cmaes.frames.seen_view import seen_views
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.synth.truth import exact_mask
from dvrk_cmaes.track.frame_fits import PredictedFrame, fit_block, fit_near, views_that_show

RIGHT = Camera(320, 240, 513, 513, 159, 121)
RIGHT_FROM_LEFT = transform(np.eye(3), [-0.0053, 0.0, 0.0])
RIG = Rig.stereo(SMALL, RIGHT, RIGHT_FROM_LEFT)
WIDER = 2  # px, of the masks of one eye
CONFIG = EstimateConfig()
SPREAD = np.diag([3e-3] * 3 + [0.1] * 6) ** 2  # of what is expected, m and rad


@cache
def world() -> tuple[Body, Posed, dict[str, np.ndarray]]:
    """Give the body, its true pose, and its exact masks in both eyes."""
    moving = moving_world(2)
    truth = moving.truths[0]
    in_right = replace(truth, camera_from_root=RIGHT_FROM_LEFT @ truth.camera_from_root)
    masks = {"left": moving.masks[0], "right": exact_mask(moving.body, RIGHT, in_right)}
    return moving.body, Posed(truth.camera_from_root, truth.values), masks


def frame(wide: str) -> FrameData:
    """Give the frame, with the mask of one eye widened all round."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * WIDER + 1, 2 * WIDER + 1))
    masks = dict(world()[2])
    masks[wide] = cv2.dilate(masks[wide].astype(np.uint8), disc) > 0
    return FrameData(seen_views(masks, RIG))


def margins(left: float, right: float) -> SessionMasks:
    return SessionMasks(left, 0.1, True, (ViewMargin("right", right, 0.1, True),))


def by_block(wide: str, masks: SessionMasks | None) -> Posed:
    """Fit the frame as a recording on disk is."""
    body, truth, _ = world()
    expected = Expected(truth, np.linalg.inv(SPREAD))
    (found,) = fit_block(body, CONFIG, [PredictedFrame("0", lambda: frame(wide), expected)], masks=masks)
    assert found is not None
    return found.fit.at


def by_step(wide: str, masks: SessionMasks | None) -> Posed:
    """Fit the frame as a stream is."""
    body, truth, _ = world()
    views = views_that_show(frame(wide).views, body)
    found, _ = fit_near(views, CONFIG, Expected(truth, np.linalg.inv(SPREAD)), None, masks, lengths={})
    return found.at


@pytest.mark.parametrize("wide", ["left", "right"])
@pytest.mark.parametrize("fitted", [by_block, by_step])
def test_each_eye_loses_its_own_margin(fitted: Callable[[str, SessionMasks | None], Posed], wide: str) -> None:
    truth = world()[1]
    own, other = (WIDER, 0.0) if wide == "left" else (0.0, WIDER), (WIDER, WIDER) if wide == "left" else (0.0, 0.0)
    off, off_as_first = (
        1e3 * float(np.linalg.norm(fitted(wide, margins(*each)).minus(truth)[:3])) for each in (own, other)
    )
    assert off < 0.3 * off_as_first


def test_views_without_a_margin_of_their_own_have_the_first_ones() -> None:
    assert margins_of(margins(0.5, 1.0), ["right", "left"]) == (1.0, 0.5)
    assert margins_of(SessionMasks(0.5, 0.1, True), ["left", "right"]) == (0.5, 0.5)
    assert margins_of(None, ["left", "right"]) == (0.0, 0.0)
