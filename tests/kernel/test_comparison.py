"""Comparisons of silhouettes with masks agree with those of whole images, blurred by OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.transforms import lookat_pose

from dvrk_cmaes import Body, Camera, Renderer, _kernel
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.sized_view import REACH, blur_filter
from dvrk_cmaes.silhouette.moving_points import moving_points

CAMERA = Camera(640, 480, 880, 880, 330, 250)
TRUE = Posed(lookat_pose(0.5, 1.0, 0.7, 0.11), np.array([0.4, -0.3, 0.5]))
BLUR = 1.2
AT = Posed.stacked(
    TRUE.moved(change)
    for change in np.random.default_rng(3).normal(size=(6, 9)) * ([0.02, 0.02, 0.02] + [0.1] * 3 + [0.2] * 3)
)
"""Poses partly outside of the image."""


def renderer(body: Body, shrink: int, threads: int = 1) -> Renderer:
    return Renderer(body, CAMERA.scaled(CAMERA.width // shrink, CAMERA.height // shrink), threads=threads)


def mask_and_weight(drawing: Renderer, ignored: bool) -> tuple[np.ndarray, np.ndarray]:
    mask = drawing.coverage(TRUE.pose[None], TRUE.joints[None])[0]
    weight = np.ones_like(mask)
    if ignored:
        weight[: len(weight) // 3] = np.linspace(0, 1, len(weight) // 3, dtype=np.float32)[:, None]
    return mask, weight


def blurred(image: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), BLUR, borderType=cv2.BORDER_REPLICATE).astype(np.float64)


@pytest.mark.parametrize("shrink", [1, 4, 20])
@pytest.mark.parametrize("lines", [1, 3])
@pytest.mark.parametrize("ignored", [False, True])
def test_losses_are_those_of_blurred_images(bundled_body: Body, shrink: int, lines: int, ignored: bool) -> None:
    drawing = renderer(bundled_body, shrink)
    mask, weight = mask_and_weight(drawing, ignored)
    target = _kernel.Target(mask, weight, blur_filter(BLUR), REACH)
    widths = [0.5, 0.03]
    np.testing.assert_allclose(target.image, blurred(mask), atol=1e-6)
    compared = drawing.compare(AT, target, widths, lines_per_pixel=lines, outlines=False)
    coverage = drawing.coverage(AT.pose, AT.joints, lines_per_pixel=lines)
    for one, image in zip(compared, coverage, strict=True):
        np.testing.assert_array_equal(one.coverage(drawing.camera.width), image)
        difference = blurred(image) - blurred(mask)
        losses = [float((w**2 * weight * np.log1p((difference / w) ** 2)).sum()) for w in widths]
        np.testing.assert_allclose(one.losses, losses, rtol=2e-5)
        assert not one.outlined


def test_points_are_those_of_outlines_and_move_as_they_do(bundled_body: Body) -> None:
    drawing = renderer(bundled_body, 2)
    target = _kernel.Target(*mask_and_weight(drawing, ignored=False), blur_filter(BLUR), REACH)
    compared = drawing.compare(AT, target, [0.5], lines_per_pixel=2)
    outlines = drawing.outlines(AT.pose, AT.joints, lines_per_pixel=2)
    moving = moving_points(bundled_body.instrument, drawing.camera, outlines, AT)
    for one, outline, moved in zip(compared, outlines, moving, strict=True):
        for name in ("link", "pixels", "normals", "points"):
            np.testing.assert_array_equal(getattr(one, name), getattr(outline, name))
        lengths = np.linalg.norm(outline.normals, axis=1)[:, None]
        np.testing.assert_allclose(one.jacobian * lengths, moved.jacobian, rtol=1e-9, atol=1e-9)
