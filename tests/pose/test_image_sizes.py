"""Images of any size and aspect: the search's sizes are exact, and every mask has a result."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.batch_sessions import QUICK_CONFIG
from helpers.transforms import lookat_pose, rotation_angle

from dvrk_cmaes import Body, Camera, Renderer, estimate
from dvrk_cmaes.evidence.gather import gather_evidence, shrunk
from dvrk_cmaes.pose.search.global_search import search_size

SEARCH = QUICK_CONFIG.search
JOINTS = np.array([[0.2, -0.3, 0.5]])
SIZES = [
    *[(720, 480), (1300, 1024), (1280, 1024), (1400, 986), (740, 540), (1264, 1008), (1000, 800), (1920, 1080)],
    *[(640, 480), (720, 576), (960, 540), (1280, 720), (3840, 2160), (160, 120), (64, 48)],
    *[(1080, 1920), (479, 641), (1281, 1023), (317, 241), (2000, 90), (37, 211)],
]


def camera_of(width: int, height: int, pixel_aspect: float = 1.0) -> Camera:
    focal = 1.4 * max(width, height)
    return Camera(width, height, focal, focal * pixel_aspect, 0.52 * width, 0.47 * height)


def drawn(body: Body, camera: Camera, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Give a pose (1, 4, 4) whose wrist is in the middle of the image, and its mask."""
    pose = lookat_pose(0.9, 0.7, 0.4, distance)[None]
    return pose, Renderer(body, camera, threads=1).masks(pose, JOINTS)[0]


@pytest.mark.parametrize("size", SIZES)
def test_silhouettes_at_sizes_of_search_agree_with_downsampled_ones(bundled_body: Body, size: tuple[int, int]) -> None:
    camera = camera_of(*size, pixel_aspect=1.09)
    renderer = Renderer(bundled_body, camera, threads=1)
    for distance in (0.06, 0.16):
        pose, mask = drawn(bundled_body, camera, distance)
        evidence = gather_evidence(mask, camera, bundled_body.instrument, features=False)
        whole = renderer.coverage(pose, JOINTS, lines_per_pixel=2)[0]
        width, height = search_size(evidence, SEARCH.width_px)
        coverage = renderer.at(width, height).coverage(pose, JOINTS, lines_per_pixel=16)[0]
        outline = np.count_nonzero((coverage > 0) & (coverage < 1))
        # An outline that lies off by d px changes the coverage of its pixels by some d.
        assert np.abs(coverage - shrunk(whole, width, height)).sum() < 0.05 * outline


@pytest.mark.parametrize("size", [(1280, 1024), (720, 480), (479, 641), (64, 48), (37, 211)])
@pytest.mark.parametrize("share", [2e-6, 0.001, 0.6, 0.9999])
def test_sizes_of_search_show_mask_of_any_area(bundled_body: Body, size: tuple[int, int], share: float) -> None:
    camera, mask = camera_of(*size), np.zeros(size[::-1], dtype=np.bool_)
    mask.ravel()[: min(max(round(share * mask.size), 1), mask.size - 1)] = True
    evidence = gather_evidence(mask, camera, bundled_body.instrument, features=False)
    width, height = search_size(evidence, SEARCH.width_px)
    inside = evidence.at_size(width, height)[0] > 0.5
    assert inside.shape == (height, width)
    assert inside.any()
    assert not inside.all()


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
def test_mode_of_a_thin_tool_is_told_in_images_that_show_it(bundled_body: Body, turn: float) -> None:
    camera = Camera(1300, 1024, 650.0, 650.0, 650.0, 512.0)
    pose = lookat_pose(0.9, turn, 0.4, 0.33)
    mask = Renderer(bundled_body, camera, threads=1).masks(pose[None], JOINTS)[0]
    values = (JOINTS[0] + [0.05, -0.05, 0.1]).tolist()
    found = estimate(mask, camera, dict(zip(bundled_body.instrument.joint_names, values, strict=True)), bundled_body)
    assert found.camera_from_root is not None
    assert np.degrees(rotation_angle(found.camera_from_root, pose)) < 3
