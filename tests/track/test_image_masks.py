"""Masks found around expected silhouettes by colours: displaced, hidden and missing instruments."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.moving_worlds import MovingWorld, moving_world

from dvrk_cmaes import Renderer
from dvrk_cmaes.synth.images import draw_image
from dvrk_cmaes.track.histogram_ratio import ColourModel
from dvrk_cmaes.track.image_masks import learned_colours, mask_around, pooled_colours

FRAMES = 3


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world()


@pytest.fixture(scope="module")
def images(world: MovingWorld) -> list[np.ndarray]:
    return [draw_image(world.camera, one, np.random.default_rng(5)) for one in world.truths[:FRAMES]]


@pytest.fixture(scope="module")
def colours(world: MovingWorld, images: list[np.ndarray]) -> ColourModel:
    """The colours of the later images."""
    models = [learned_colours(images[k], world.masks[k], None) for k in (1, 2)]
    return pooled_colours([model for model in models if model is not None])


def iou(first: np.ndarray, second: np.ndarray) -> float:
    return float((first & second).sum() / (first | second).sum())


def silhouette(world: MovingWorld, shift: tuple[float, float, float]) -> np.ndarray:
    """Draw the first frame's silhouette, moved by some metres."""
    truth = world.truths[0]
    pose = truth.camera_from_root.copy()
    pose[:3, 3] += shift
    return Renderer(world.body, world.camera, threads=1).masks(pose[None], truth.values[None])[0]


def test_mask_is_found_where_the_silhouette_is_some_pixels_beside_it(
    world: MovingWorld, images: list[np.ndarray], colours: ColourModel
) -> None:
    beside = silhouette(world, (1.2e-3, -0.8e-3, 0.0))
    assert iou(beside, world.masks[0]) < 0.9
    found = mask_around(images[0], beside, colours, spread=8.0)
    assert found is not None
    assert iou(found.mask, world.masks[0]) > 0.96
    assert found.unsupported < 0.1


def test_tissue_before_the_instrument_is_not_in_the_mask(
    world: MovingWorld, images: list[np.ndarray], colours: ColourModel
) -> None:
    hidden = np.zeros_like(world.masks[0])
    middle = int(np.median(np.nonzero(world.masks[0])[1]))
    hidden[:, middle - 12 : middle + 12] = True
    tissue = images[0][~world.masks[0]].reshape(-1, 3)
    covered = images[0].copy()
    covered[hidden] = np.median(tissue, axis=0)
    found = mask_around(covered, world.masks[0], colours)
    assert found is not None
    inner = hidden & world.masks[0]
    assert found.mask[inner].mean() < 0.3
    assert iou(found.mask & ~hidden, world.masks[0] & ~hidden) > 0.9
