"""What moves before tissue that moves a little: grey shafts, shadows, and images that tell nothing."""

from __future__ import annotations

import cv2
import numpy as np

from dvrk_cmaes.segment.background import FEWEST
from dvrk_cmaes.segment.moving_colours import moving_pixels

SIZE = (120, 160)


def tissue(shift: float) -> np.ndarray:
    """Draw tissue that is moved by some pixels."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)
    red = 150 + 30 * np.sin((u + shift) / 9)
    green = 60 + 20 * np.sin((u + shift) / 14 + v / 11)
    return np.asarray(np.stack([0.9 * green, green, red], axis=-1), np.uint8)


def recording(count: int, *, shown: bool = True) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Draw images of a grey shaft, with a shadow beside it, that moves from left to right; and its true pixels."""
    images, shafts = [], []
    for k in range(count):
        image, shaft = tissue(2 * np.sin(k)), np.zeros(SIZE, np.uint8)
        left = 10 + 130 * k // count
        cv2.rectangle(shaft, (left, 0), (left + 14, 90), 1, -1)
        if shown:
            shadow = np.roll(shaft, 9, axis=1) > 0
            image[shadow] = (0.5 * image[shadow]).astype(np.uint8)
            image[shaft > 0] = 70
        images.append(image)
        shafts.append(shaft > 0)
    return images, shafts


def test_shaft_moves_and_its_shadow_and_the_tissue_do_not() -> None:
    images, shafts = recording(12)
    found = moving_pixels(images)
    assert found is not None
    for (small, moving), shaft in zip(found, shafts, strict=True):
        assert small.shape == (*SIZE, 3)
        assert moving[shaft].mean() > 0.9
        assert moving[~shaft].mean() < 0.05


def test_images_without_anything_that_moves_tell_nothing() -> None:
    assert moving_pixels(recording(12, shown=False)[0]) is None


def test_few_images_and_images_of_several_sizes_tell_nothing() -> None:
    images, _ = recording(FEWEST)
    assert moving_pixels(images) is not None
    assert moving_pixels(images[1:]) is None
    assert moving_pixels([*images, images[0][:60]]) is None
