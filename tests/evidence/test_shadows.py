"""Stretches of a mask that are a shadow: no edge of the image is at their contour, and a clear one farther inside."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from dvrk_cmaes.evidence.shadows import shadow_stretches

RNG_SEED = 3


def scene(width: int) -> tuple[np.ndarray, np.ndarray]:
    """Give the image of a bright bar with a highlight before dark tissue, and the bar's mask."""
    height, size = width * 3 // 4, width / 640
    rng = np.random.default_rng(RNG_SEED)
    noise = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 6 * size)
    image = 70 + 8 * noise / noise.std()
    down, across = np.mgrid[:height, :width]
    off = (across - 0.5 * width) * np.cos(0.4) + (down - 0.5 * height) * np.sin(0.4)
    bar = np.abs(off) < 32 * size
    image[bar] = 130 + 60 * np.exp(-((off[bar] / (6 * size)) ** 2))
    image = cv2.GaussianBlur(image, (0, 0), size) + rng.normal(size=image.shape)
    return np.repeat(np.clip(image, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2), bar


def shifted(mask: np.ndarray, pixels: float) -> np.ndarray:
    moved = cv2.warpAffine(mask.astype(np.uint8), np.array([[1.0, 0.0, pixels], [0.0, 1.0, 0.0]]), mask.shape[::-1])
    lower = np.arange(mask.shape[0])[:, None] > mask.shape[0] // 2
    return np.asarray(mask | ((moved > 0) & lower))


@pytest.mark.parametrize("width", [320, 640, 1280])
def test_shadow_is_found_where_it_is(width: int) -> None:
    image, bar = scene(width)
    mask = shifted(bar, 9 * width / 640)
    found = shadow_stretches(image, mask)
    assert found is not None
    shadow = mask & ~bar
    assert found[shadow].mean() > 0.7
    assert (found & ~cv2.dilate(shadow.astype(np.uint8), np.ones((9, 9))).astype(bool)).sum() < 0.25 * found.sum()


@pytest.mark.parametrize("width", [320, 640, 1280])
def test_right_mask_has_none(width: int) -> None:
    image, bar = scene(width)
    assert shadow_stretches(image, bar) is None
    rough = cv2.dilate(bar.astype(np.uint8), np.ones((3, 3))) > 0
    assert shadow_stretches(image, rough) is None


def test_image_that_shows_nothing_tells_nothing() -> None:
    _, bar = scene(320)
    assert shadow_stretches(np.full((240, 320, 3), 90, np.uint8), bar) is None
