"""Rays traced through the pixels of a synthetic image see the links where they are."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from helpers.moving_worlds import SMALL, MovingWorld, moving_world

from dvrk_cmaes.synth.views import NOTHING, LinkView, links_at, pixel_rays, trace_links, trace_rays


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world(9)


def view_of(world: MovingWorld, frame: int) -> LinkView:
    truth = world.truths[frame]
    return trace_links(truth.instrument, SMALL, truth.camera_from_root, truth.values)


@pytest.mark.parametrize("frame", [0, 4, 8])
def test_each_link_is_seen_on_its_own_surface(world: MovingWorld, frame: int) -> None:
    truth, view = world.truths[frame], view_of(world, frame)
    points = view.depth[..., None] * pixel_rays(SMALL)
    poses = truth.camera_from_root @ truth.instrument.forward(truth.values)
    assert {*np.unique(view.link).tolist()} == {NOTHING, *range(len(poses))}
    for k, (link, pose) in enumerate(zip(truth.instrument.links, poses, strict=True)):
        seen = view.link == k
        own = (points[seen] - pose[:3, 3]) @ pose[:3, :3]
        assert (own > link.vertices.min(axis=0) - 1e-5).all()
        assert (own < link.vertices.max(axis=0) + 1e-5).all()
        assert (np.sum(view.normal[seen] * view.direction[seen], axis=1) < 1e-6).all()  # it faces the camera
    different = (view.link != NOTHING) != world.masks[frame]
    assert different.sum() < 0.002 * world.masks[frame].sum()


def test_each_pose_has_a_view_of_its_own_in_any_order(world: MovingWorld) -> None:
    first = [view_of(world, frame) for frame in range(9)]
    assert all((one.link != other.link).any() for one, other in pairwise(first))
    for frame in (8, 0, 8, 3):
        again = view_of(world, frame)
        assert np.array_equal(again.link, first[frame].link)
        assert np.array_equal(again.depth, first[frame].depth)


def test_part_of_the_pixels_and_given_rays_see_the_same(world: MovingWorld) -> None:
    truth, view = world.truths[0], view_of(world, 0)
    where = np.zeros(view.link.shape, bool)
    where[60:200, 40:250:2] = True
    links = links_at(world.body, SMALL, truth.camera_from_root, truth.values, where)
    assert np.array_equal(links, np.where(where, view.link, NOTHING))
    some = trace_rays(truth.instrument, pixel_rays(SMALL)[100:140], truth.camera_from_root, truth.values)
    assert np.array_equal(some.link, view.link[100:140])
    assert np.array_equal(some.depth, view.depth[100:140])
