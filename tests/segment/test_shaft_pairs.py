"""Pairs of edges in images of drawn shafts, and the stretch of their axis in which an instrument may be."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Posed, frame_along, transform
from dvrk_cmaes.segment.shaft_pairs import find_pairs
from dvrk_cmaes.silhouette import Renderer
from dvrk_cmaes.silhouette.prepare import prepare

CAMERA = Camera(480, 384, 500.0, 500.0, 239.5, 191.5)
BODY = prepare("lnd")


@pytest.mark.parametrize(
    ("axis", "root"),
    [
        ((0.9, 0.25, 0.36), (-0.026, 0.0, 0.11)),
        ((0.31, 0.11, 0.94), (-0.017, 0.008, 0.062)),
        ((-0.42, -0.31, 0.85), (0.014, 0.003, 0.088)),
    ],
)
def test_the_axis_is_found_and_its_stretch_is_in_the_picture(axis: tuple[float, ...], root: tuple[float, ...]) -> None:
    """Also of an axis that comes steeply towards the camera, whose vanishing point is in the picture.

    Edges tell an axis' tilt in depth roughly.
    """
    direction = np.array(axis) / np.linalg.norm(axis)
    at = Posed(transform(frame_along(direction), np.array(root))[None], np.zeros((1, 3)))
    image = np.where(Renderer(BODY, CAMERA, threads=1).masks(at.pose, at.joints)[0], 60, 180).astype(np.uint8)
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
