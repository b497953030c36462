"""What an outline tells of a pose: the points of it that count, and how much."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.frame_terms import readings_of, view_at, view_of
from helpers.transforms import apply, lookat_pose

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.evidence.outline_noise import OutlineNoise
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.refine.information import information_of_views, outline_information
from dvrk_cmaes.pose.terms.readings_term import ReadingsTerm
from dvrk_cmaes.pose.terms.sized_view import SizedView

CAMERA = Camera(320, 240, 440, 440, 160, 120)
TRUE = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.5]))
JAW = 8
SIGMA, LENGTH = 0.5, 8.0  # px


def silhouette(body: Body) -> np.ndarray:
    return Renderer(body, CAMERA).masks(TRUE.pose[None], TRUE.joints[None])[0]


def discs(body: Body, radius: float) -> np.ndarray:
    """Give discs of a radius in px around the jaw tips."""
    tips = CAMERA.project(apply(TRUE.pose, body.instrument.ends(TRUE.joints)))
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    return np.any([np.hypot(columns - u, rows - v) < radius for u, v in tips], axis=0)


def information(
    body: Body, mask: np.ndarray, ignore: np.ndarray | None = None, sigma: float = SIGMA, length: float = LENGTH
) -> np.ndarray:
    """Give the information of a mask's outline about the true pose."""
    view = view_of(body, CAMERA, mask, ignore=ignore)
    return outline_information(SizedView(view, blur=1.2), TRUE, OutlineNoise(sigma, length))


def test_outline_far_from_the_masks_contour_tells_nothing(bundled_body: Body) -> None:
    """A lump covers the jaws whole: of their angle, the mask tells as little as if the lump were ignored."""
    mask, lump = silhouette(bundled_body), discs(bundled_body, 40)
    assert information(bundled_body, mask)[JAW, JAW] > 0
    assert information(bundled_body, mask, ignore=lump)[JAW, JAW] == pytest.approx(0.0)
    assert information(bundled_body, mask | lump)[JAW, JAW] == pytest.approx(0.0)


def test_shadows_beside_the_shaft_leave_the_depth_uncertain(bundled_body: Body) -> None:
    """Noise that stays the same over much contour is that of shadows; a shaft with a shadow looks wider, so closer."""
    mask = silhouette(bundled_body)
    away = TRUE.pose[:3, :3].T @ (TRUE.pose[:3, 3] / np.linalg.norm(TRUE.pose[:3, 3]))
    short, long = (
        away @ np.linalg.inv(information(bundled_body, mask, sigma=1.0, length=length))[:3, :3] @ away
        for length in (15.0, 38.0)
    )
    assert long > 2 * short


def test_readings_count_in_the_first_view_only(bundled_body: Body) -> None:
    view = view_at(bundled_body, CAMERA, TRUE)
    views = [SizedView(view, blur=1.2)] * 2
    readings = ReadingsTerm(readings_of(bundled_body, TRUE.joints))
    with_readings, without = (information_of_views(views, terms, TRUE) for terms in ([readings], []))
    np.testing.assert_array_equal(with_readings[1], without[1])
    assert (np.diag(with_readings[0] - without[0])[6:] > 0).all()
