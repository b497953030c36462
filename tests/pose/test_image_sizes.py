"""Images of any size and aspect: the result explains the mask."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.batch_sessions import QUICK_CONFIG
from helpers.transforms import lookat_pose, rotation_angle

from dvrk_cmaes import Body, Camera, Renderer, estimate

JOINTS = np.array([[0.2, -0.3, 0.5]])


def camera_of(width: int, height: int, pixel_aspect: float = 1.0) -> Camera:
    focal = 1.4 * max(width, height)
    return Camera(width, height, focal, focal * pixel_aspect, 0.52 * width, 0.47 * height)


def drawn(body: Body, camera: Camera, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Give a pose (1, 4, 4) whose wrist is in the middle of the image, and its mask."""
    pose = lookat_pose(0.9, 0.7, 0.4, distance)[None]
    return pose, Renderer(body, camera, threads=1).masks(pose, JOINTS)[0]


@pytest.mark.parametrize(
    ("size", "distance"),
    [((1280, 1024), 0.25), ((720, 576), 0.08), ((479, 641), 0.12), ((64, 48), 0.1), ((37, 211), 0.2)],
)
def test_estimate_of_any_size_explains_its_mask(bundled_body: Body, size: tuple[int, int], distance: float) -> None:
    camera = camera_of(*size, pixel_aspect=1.09)
    _, mask = drawn(bundled_body, camera, distance)
    readings = dict(zip(bundled_body.instrument.joint_names, JOINTS[0].tolist(), strict=True))
    result = estimate(mask, camera, readings, bundled_body, config=replace(QUICK_CONFIG, threads=1))
    assert result.quality is not None
    assert result.quality.iou > 0.85
    assert json.dumps(result.to_dict(), allow_nan=False)


@pytest.mark.parametrize("turn", [0.7, 4.7])
def test_mode_of_a_thin_tool_is_found_in_images_that_show_it(bundled_body: Body, turn: float) -> None:
    camera = Camera(1300, 1024, 650.0, 650.0, 650.0, 512.0)
    pose = lookat_pose(0.9, turn, 0.4, 0.33)
    mask = Renderer(bundled_body, camera, threads=1).masks(pose[None], JOINTS)[0]
    values = (JOINTS[0] + [0.05, -0.05, 0.1]).tolist()
    found = estimate(mask, camera, dict(zip(bundled_body.instrument.joint_names, values, strict=True)), bundled_body)
    assert found.camera_from_root is not None
    assert np.degrees(rotation_angle(found.camera_from_root, pose)) < 3
