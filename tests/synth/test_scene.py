"""Rays through a synthetic image's pixels meet the links where they are, and cover what their silhouette covers."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.moving_worlds import SMALL, MovingWorld, moving_world

from dvrk_cmaes.silhouette import Renderer
from dvrk_cmaes.synth.scene import NOTHING, links_seen, pixel_rays, see


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world(9)


@pytest.mark.parametrize("frame", [0, 4, 8])
def test_each_link_is_seen_on_its_own_surface(world: MovingWorld, frame: int) -> None:
    truth = world.truths[frame]
    seen = see(SMALL, [truth])
    links = np.where(seen.face == NOTHING, NOTHING, seen.scene.link[seen.face])
    points = seen.depth[..., None] * pixel_rays(SMALL)
    poses = truth.camera_from_root @ truth.instrument.forward(truth.values)
    assert {*np.unique(links).tolist()} == {NOTHING, *range(len(poses))}
    assert np.array_equal(links, links_seen(SMALL, truth))
    for k, (link, pose) in enumerate(zip(truth.instrument.links, poses, strict=True)):
        own = (points[links == k] - pose[:3, 3]) @ pose[:3, :3]
        assert (own > link.vertices.min(axis=0) - 1e-5).all()
        assert (own < link.vertices.max(axis=0) + 1e-5).all()
        normals = seen.scene.normals(seen.face[links == k])
        assert (np.sum(normals * pixel_rays(SMALL)[links == k], axis=1) < 1e-6).all()  # they face the camera


@pytest.mark.parametrize("frame", [0, 8])
def test_coverage_is_that_of_the_silhouette(world: MovingWorld, frame: int) -> None:
    truth = world.truths[frame]
    (coverage,) = see(SMALL, [truth]).coverage
    drawn = Renderer(world.body, SMALL, threads=1).coverage(
        truth.camera_from_root[None], truth.values[None], lines_per_pixel=4
    )[0]
    partial = (drawn > 0) & (drawn < 1)
    assert np.abs(coverage - drawn)[partial].mean() < 0.03
    assert ((coverage > 0.5) != (drawn > 0.5)).sum() < 0.001 * (drawn > 0.5).sum()
