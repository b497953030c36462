"""What the outline of a frame's own estimate tells: overlap, and correlation length of the contour's errors."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.session_worlds import SMALL
from helpers.transforms import lookat_pose, moved

from dvrk_cmaes import Body, Renderer
from dvrk_cmaes.calibration.frame_fit import OwnEstimate
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.views import FrameView

TRUE = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.2, -0.3, 0.5]))


@pytest.fixture(scope="module")
def view(bundled_body: Body) -> FrameView:
    renderer = Renderer(bundled_body, SMALL, threads=1)
    evidence = gather_evidence(renderer.masks(TRUE.pose[None], TRUE.joints[None])[0], SMALL, bundled_body.instrument)
    return FrameView("", evidence, renderer, np.eye(4))


def test_true_pose_overlaps_fully_with_errors_of_single_pixels(view: FrameView) -> None:
    own = OwnEstimate.of([view], TRUE)
    assert own.iou == 1.0
    assert own.lengths[0] < 4


def test_shifted_pose_overlaps_less_and_errs_alike_along_the_contour(view: FrameView) -> None:
    own = OwnEstimate.of([view], TRUE.moved(np.array([1e-3, 0, 0, 0, 0, 0, 0, 0, 0])))
    assert 0.3 < own.iou < 0.95
    assert own.lengths[0] > 10


def test_views_are_measured_each_and_overlap_is_their_mean(view: FrameView) -> None:
    shifted = FrameView("right", view.evidence, view.renderer, moved(np.eye(4), np.array([1e-3, 0, 0, 0, 0, 0])))
    both = OwnEstimate.of([view, shifted], TRUE)
    alone = OwnEstimate.of([shifted], TRUE)
    assert both.lengths[1:] == alone.lengths
    assert both.iou == pytest.approx((1 + alone.iou) / 2)
