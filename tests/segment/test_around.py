"""The mask around a silhouette that is expected: an outline that is off, occlusion, other pieces, prompts."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from dvrk_cmaes.segment.around import ROUGH, mask_around, segmentation_around
from dvrk_cmaes.segment.prompts import no_prompts
from dvrk_cmaes.segment.sizes import resized

GREY, TISSUE = (120, 118, 116), (60, 70, 170)


def bar(left: int = 60, right: int = 90, bottom: int = 150) -> np.ndarray:
    """Return a shaft from the upper border, with a narrower tip, of an image of 200 x 160 px."""
    mask = np.zeros((160, 200), np.bool_)
    mask[: bottom - 40, left:right] = True
    mask[bottom - 40 : bottom, left + 8 : right - 8] = True
    return mask


def picture(*masks: np.ndarray, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = np.full((160, 200, 3), TISSUE, np.float32)
    for mask in masks:
        image[mask] = GREY
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + 4 * rng.standard_normal(image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


def overlap(found: np.ndarray, mask: np.ndarray) -> float:
    return float((found & mask).sum() / (found | mask).sum())


@pytest.mark.parametrize("off", [-3, 0, 3])
def test_the_outline_is_the_pictures_where_the_silhouette_is_off(off: int) -> None:
    found = mask_around(picture(bar()), bar(60 + off, 90 + off))
    assert found is not None
    assert overlap(found.mask, bar()) > 0.97


def test_without_a_say_of_the_silhouette_near_its_outline_it_may_be_farther_off() -> None:
    assert overlap(bar(68, 98), bar()) < 0.7
    found = mask_around(picture(bar()), bar(68, 98), ROUGH)
    assert found is not None
    assert overlap(found.mask, bar()) > 0.95


def test_nothing_is_instrument_beyond_the_reach() -> None:
    wide = bar(20, 150)
    found = mask_around(picture(wide), bar(), reach=4.0)
    assert found is not None
    away = cv2.distanceTransform((~bar()).astype(np.uint8), cv2.DIST_L2, 5)
    assert not found.mask[away > 9].any()


def test_another_piece_of_the_same_colour_is_left_out() -> None:
    beside = np.zeros((160, 200), np.bool_)
    beside[30:100, 102:112] = True
    found = mask_around(picture(bar(), beside), bar(), reach=30.0)
    assert found is not None
    assert not found.mask[beside].any()
    assert overlap(found.mask, bar()) > 0.95


def test_a_prompt_gives_the_label_of_its_pixels() -> None:
    covered = np.zeros((160, 200), np.bool_)
    covered[40:60] = True
    found = mask_around(picture(bar()), bar(), prompts=no_prompts(covered.shape).with_outside(covered))
    assert found is not None
    assert not found.mask[covered].any()
    assert overlap(found.mask, bar() & ~covered) > 0.95


@pytest.mark.parametrize("flat", [np.zeros((160, 200), np.bool_), np.ones((160, 200), np.bool_)])
def test_an_empty_or_full_silhouette_has_no_mask(flat: np.ndarray) -> None:
    assert mask_around(picture(bar()), flat) is None
    found = segmentation_around(picture(bar()), flat, no_prompts(flat.shape))
    assert not found.mask.any()
    assert found.confidence == 0


def test_a_large_image_has_the_same_mask_as_a_small_one() -> None:
    size = (1400, 1120)
    image = np.asarray(cv2.resize(picture(bar()), size, interpolation=cv2.INTER_LINEAR), np.uint8)
    found = segmentation_around(
        image, np.roll(resized(bar(), size), 4, axis=1), no_prompts(image.shape)
    )  # within the free band
    assert found.mask.shape == size[::-1]
    assert overlap(found.mask, resized(bar(), size)) > 0.97
