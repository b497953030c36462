"""Layers and pictures from which a network for masks is trained: repeatable, and with the masks of what they show."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from masknet.compose import Layers, compose
from masknet.draw import SIZE, main

SIZES = (160, 128), (320, 256)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("layers")
    main([str(folder), "--seed", "7", "--tools", "4", "--scenes", "6"])
    return folder


def test_a_layer_has_an_instrument_that_comes_from_the_border_and_its_shaft(folder: Path) -> None:
    tools, tips = np.load(folder / "tools_7.npy"), np.load(folder / "tips_7.npy")
    assert tools.shape == (4, SIZE, SIZE, 6)
    for part, tip in zip(tools[..., 2], tips, strict=True):
        border = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
        assert (border > 0).any()
        assert (part == 1).any()
        x, y = tip.astype(int)
        near = part[max(y - 40, 0) : y + 40, max(x - 40, 0) : x + 40]
        assert (near > 1).any()


def test_a_picture_is_repeatable_and_differs_between_seeds(folder: Path) -> None:
    layers = Layers(folder)
    first, again, other = (compose(layers, np.random.default_rng(seed), SIZES[0]) for seed in (1, 1, 2))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])


@pytest.mark.parametrize("size", SIZES)
def test_outlines_of_masks_are_edges_of_their_pictures(folder: Path, size: tuple[int, int]) -> None:
    layers, steeper = Layers(folder), []
    for seed in range(30):
        picture, mask = compose(layers, np.random.default_rng([3, seed]), size)
        assert picture.shape == (*size[::-1], 3)
        assert mask.shape == size[::-1]
        inside = (mask > 127).astype(np.uint8)
        outline = cv2.morphologyEx(inside, cv2.MORPH_GRADIENT, np.ones((3, 3))) > 0
        if outline.any() and not outline.all():
            grey = cv2.GaussianBlur(picture, (0, 0), 1.0).mean(axis=2)
            slope = np.hypot(*np.gradient(grey))
            steeper.append(slope[outline].mean() > 1.5 * slope[~outline].mean())
    assert len(steeper) > 15
    assert np.mean(steeper) > 0.7
