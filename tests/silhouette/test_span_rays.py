"""Silhouettes whose spans are decided by rays are those of counted layers, up to numerical ties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.transforms import lookat_pose, moved

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.silhouette.prepare import body_by

CAMERAS = {
    "pinhole": Camera(160, 120, 220.7, 220.7, 110.9, 47.2),
    "plumb_bob": Camera(160, 120, 206, 225, 99, 61, (-0.3517, 0.7089, 0.0044, -0.0008, -0.9176)),
    "equidistant": Camera(160, 120, 80, 80, 80, 60, (-0.02, 0.01, 0.0, 0.0), "equidistant"),
}
COUNT = 40


def renderers(body: Body, camera: Camera) -> tuple[Renderer, Renderer]:
    """Give renderers that count layers and that trace rays."""
    return Renderer(body, camera, threads=1), Renderer(replace(body, method="rays"), camera, threads=1)


def poses(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Give poses with every part of the instrument in the image, at its border, beside it and behind the camera."""
    rng = np.random.default_rng(7)
    change = rng.standard_normal((COUNT, 6)) * [0.02, 0.02, 0.04, 0.7, 0.7, 2.0]
    return moved(lookat_pose(0.6, 1.0, -0.4, 0.1), change), rng.uniform(*body.instrument.limits.T, (COUNT, 3))


@pytest.mark.parametrize("name", CAMERAS)
def test_masks_are_the_same(bundled_body: Body, name: str) -> None:
    count, rays = renderers(bundled_body, CAMERAS[name])
    one, other = (renderer.masks(*poses(bundled_body)) for renderer in (count, rays))
    assert one.any(axis=(1, 2)).sum() > COUNT // 2
    assert (one != other).sum(axis=(1, 2)).max() <= 1
    assert count.rays == 0
    assert rays.rays > 1000


def test_outlines_are_the_same(bundled_body: Body) -> None:
    count, rays = renderers(bundled_body, CAMERAS["pinhole"])
    at = poses(bundled_body)
    for one, other in zip(count.outlines(*at), rays.outlines(*at), strict=True):
        assert abs(len(one.pixels) - len(other.pixels)) <= 4
        apart = np.linalg.norm(one.pixels[:, None] - other.pixels, axis=2)
        if apart.size:
            assert (apart.min(axis=1) > 0.02).sum() <= 4


def test_method_is_that_of_the_body(bundled_body: Body) -> None:
    traced = body_by(bundled_body, "rays")
    assert traced.method == traced.decimated(1e-3).method == "rays"
    assert body_by(bundled_body, "rays") is traced
    assert body_by(bundled_body, "count") is bundled_body
