"""Pairs of edges in images of drawn shafts, and the stretch of their axis in which an instrument may be."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.transforms import exp_rotation, transform

from dvrk_cmaes import Camera, Renderer, prepare
from dvrk_cmaes.camera import View
from dvrk_cmaes.geometry import frame_along
from dvrk_cmaes.segment.segmentation import Hints
from dvrk_cmaes.segment.shaft_pairs import find_pairs, prompt_in

CAMERA = Camera(480, 384, 500.0, 500.0, 239.5, 191.5)
BODY = prepare("lnd")
LEFT = View("left", CAMERA, np.eye(4))
OTHER = Camera(640, 400, 620.0, 610.0, 330.0, 190.0, (-0.2, 0.05, 0.0, 0.0, 0.0))
RIGHT = View("right", OTHER, transform(exp_rotation(np.array([0.02, -0.05, 0.1])), [-0.0053, 0.001, 0.0]))


AXES = pytest.mark.parametrize(
    ("axis", "root"),
    [
        ((0.9, 0.25, 0.36), (-0.026, 0.0, 0.11)),
        ((0.31, 0.11, 0.94), (-0.017, 0.008, 0.062)),
        ((-0.42, -0.31, 0.85), (0.014, 0.003, 0.088)),
    ],
)


def drawn(axis: tuple[float, ...], root: tuple[float, ...], view: View = LEFT) -> np.ndarray:
    """Draw an instrument's silhouette in a view."""
    pose = view.view_from_camera @ transform(frame_along(np.array(axis) / np.linalg.norm(axis)), np.array(root))
    return Renderer(BODY, view.camera, threads=1).masks(pose[None], np.zeros((1, 3)))[0]


@AXES
def test_the_axis_is_found_and_its_stretch_is_in_the_picture(axis: tuple[float, ...], root: tuple[float, ...]) -> None:
    """Also of an axis that comes steeply towards the camera, whose vanishing point is in the picture.

    Edges tell an axis' tilt in depth roughly.
    """
    direction = np.array(axis) / np.linalg.norm(axis)
    image = np.where(drawn(axis, root), 60, 180).astype(np.uint8)
    assert BODY.instrument.shaft is not None
    pairs = find_pairs(image, CAMERA, BODY.instrument.shaft.radius, np.zeros(image.shape, np.bool_), 8)
    away = [np.linalg.norm(np.cross(pair.direction, np.array(root) - pair.point)) for pair in pairs]
    turned = [np.degrees(np.arccos(min(abs(float(pair.direction @ direction)), 1))) for pair in pairs]
    right = [k for k in range(len(pairs)) if away[k] < 0.004 and turned[k] < 9]
    assert right
    pair = pairs[right[0]]
    along = float((np.array(root) - pair.point) @ pair.direction)
    assert pair.begin < along < pair.end
    ends = pair.point + np.array([[pair.begin], [pair.end]]) * pair.direction
    assert ((ends[:, 2] > 0.014) & (ends[:, 2] < 0.51)).all()
    pixels = CAMERA.project(ends)
    assert ((pixels > -8) & (pixels < np.array([488, 392]))).all()


def test_a_short_shaft_is_among_the_pairs_beside_many_long_lines() -> None:
    """Of one long line at most five pairs are kept, or stripes would be all of them."""
    axis, root = np.array([0.9, 0.25, 0.36]), (-0.03, 0.02, 0.11)
    image = np.full((384, 480), 180, np.uint8)
    image[10:90] = 180 - 60 * (np.arange(10, 90) // 10 % 2)[:, None]
    image[drawn((0.9, 0.25, 0.36), root)] = 60
    assert BODY.instrument.shaft is not None
    pairs = find_pairs(image, CAMERA, BODY.instrument.shaft.radius, np.zeros(image.shape, np.bool_), 28)
    away = [np.linalg.norm(np.cross(pair.direction, np.array(root) - pair.point)) for pair in pairs]
    turned = [np.degrees(np.arccos(min(abs(float(pair.direction @ axis / np.linalg.norm(axis))), 1))) for pair in pairs]
    assert any(away[k] < 0.004 and turned[k] < 12 for k in range(len(pairs)))


@pytest.mark.parametrize(
    ("axis", "root"),
    [((0.9, 0.25, 0.36), (-0.026, 0.0, 0.11)), ((-0.42, -0.31, 0.85), (0.014, 0.003, 0.088))],
)
def test_a_mask_in_one_view_gives_a_point_in_another_one(axis: tuple[float, ...], root: tuple[float, ...]) -> None:
    mask = drawn(axis, root, RIGHT)
    hints = prompt_in(RIGHT, drawn(axis, root), LEFT, BODY)
    ((u, v),) = hints.points
    within = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    assert within[round(v), round(u)] > 3


@pytest.mark.parametrize("mask", [np.zeros((384, 480), np.bool_), np.ones((384, 480), np.bool_)])
def test_a_mask_without_sides_gives_no_point(mask: np.ndarray) -> None:
    assert prompt_in(RIGHT, mask, LEFT, BODY) == Hints()


def test_a_point_outside_the_other_view_is_none() -> None:
    beside = View("right", CAMERA, transform(np.eye(3), [-0.4, 0.0, 0.0]))
    assert prompt_in(beside, drawn((0.9, 0.25, 0.36), (-0.026, 0.0, 0.11)), LEFT, BODY) == Hints()
