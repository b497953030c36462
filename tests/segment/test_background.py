"""The instrument before a background that stands still, on drawings of a bench with known masks and on real images."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.drawn_tools import Drawing, draw_tool
from helpers.files import read_image

from dvrk_cmaes import InputError
from dvrk_cmaes.runs.backgrounds import learned_backgrounds
from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.background import learn_background, segment_before
from dvrk_cmaes.segment.prompts import Prompts
from dvrk_cmaes.segment.segmentation import GUESS, SegmentSettings

HEIGHT, WIDTH = 240, 320
PAPER, CLOTH = (165, 165, 165), (120, 90, 40)


def bench(number: int, ground: tuple[int, int, int] = PAPER, *, texture: float = 0.0) -> Drawing:
    """Draw an instrument with a soft shadow and highlights over a table under a lamp, at a place by its number."""
    rng = np.random.default_rng(number)
    fine, shapes = 4, np.zeros((HEIGHT * 4, WIDTH * 4), np.uint8)
    shift = np.array([-60 + 11 * (number % 12), -70 + 47 * (number % 5)])
    for part in (
        [[-200, 70], [170, 104], [170, 142], [-200, 110]],
        [[168, 104], [205, 110], [210, 132], [168, 142]],
        [[204, 110], [252, 112], [253, 118], [212, 124]],
        [[206, 120], [250, 132], [248, 138], [202, 130]],
    ):
        cv2.fillPoly(shapes, [(np.array(part) + shift) * fine], 1)
    cover = cv2.resize(shapes.astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    v, u = np.indices((HEIGHT, WIDTH))
    lamp = 1 - 0.9 * ((u / WIDTH - 0.55) ** 2 + (v / HEIGHT - 0.5) ** 2)
    folds = cv2.GaussianBlur(np.random.default_rng(99).standard_normal((HEIGHT, WIDTH)).astype(np.float32), (0, 0), 3)
    image = np.array(ground, np.float32) * (lamp * (1 + texture * folds / folds.std()))[..., None]
    image *= (1 - 0.25 * cv2.GaussianBlur(np.pad(cover, ((9, 0), (3, 0)))[:HEIGHT, :WIDTH], (0, 0), 4))[..., None]
    colour = (lamp * (52 + 25 * np.cos((v - shift[1] - 112) / 9)))[..., None] * np.ones(3)
    image = image * (1 - cover[..., None]) + colour * cover[..., None]
    for _ in range(6):
        at = shift + rng.uniform((172, 108), (205, 130))
        image[np.hypot(u - at[0], v - at[1]) < 1.6] = 240
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0, 1.0, image.shape[:2])[..., None]
    return Drawing(np.clip(image, 0, 255).astype(np.uint8), cover > 0.5)


GROUNDS: dict[str, Callable[[int], Drawing]] = {
    "paper": bench,
    "textured cloth": lambda number: bench(number, CLOTH, texture=0.08),
}


@cache
def drawn_on(ground: str) -> list[Drawing]:
    """Draw the instrument at 16 places on a ground."""
    return [GROUNDS[ground](number) for number in range(16)]


@cache
def learned_on(ground: str) -> np.ndarray:
    """Learn the background from all these drawings."""
    background = learn_background([each.image for each in drawn_on(ground)])
    assert background is not None
    background.setflags(write=False)
    return background


@pytest.mark.parametrize("ground", GROUNDS)
def test_moving_instrument_is_told_from_what_stands_still(ground: str) -> None:
    for each in drawn_on(ground)[::3]:
        found = segment(each.image, background=learned_on(ground))
        assert each.overlap(found.mask) > 0.93
        assert found.confidence > 0.7


def test_learned_background_shows_no_instrument() -> None:
    drawn = drawn_on("textured cloth")
    free = np.stack([np.where(each.mask[..., None], np.nan, each.image.astype(float)) for each in drawn])
    assert np.abs(np.nanmedian(free, axis=0) - learned_on("textured cloth")).mean() < 3


def test_single_image_is_told_from_a_smooth_background() -> None:
    for each in drawn_on("paper")[::4]:
        found = segment(each.image)
        assert found.before == "smooth background"
        assert each.overlap(found.mask) > 0.93
        assert found.confidence > 0.7


@pytest.mark.parametrize(("gain", "offset", "noise"), [(0.6, 0, 0), (1.4, 0, 0), (1.0, 30, 0), (0.8, 10, 5)])
def test_other_light_and_noise_change_little(gain: float, offset: float, noise: float) -> None:
    rng = np.random.default_rng(0)
    images = [
        np.clip(gain * each.image + offset + rng.normal(0, noise, each.image.shape), 0, 255).astype(np.uint8)
        for each in drawn_on("paper")
    ]
    background = learn_background(images)
    assert background is not None or noise
    for each, image in list(zip(drawn_on("paper"), images, strict=True))[::5]:
        found = segment(image, background=background)
        assert each.overlap(found.mask) > 0.9


def test_instrument_on_tissue_is_found_by_colours_as_before() -> None:
    drawn = draw_tool(shadow=0.5, vignette=0.8, glare=15)
    found = segment(drawn.image)
    assert found.before is None
    assert drawn.overlap(found.mask) > 0.9


def test_background_that_moves_or_is_seen_too_seldom_is_not_learned() -> None:
    images = [each.image for each in drawn_on("textured cloth")]
    assert learn_background(images[:7]) is None
    assert learn_background([np.roll(image, 9 * k, axis=1) for k, image in enumerate(images)]) is None
    assert learn_background([*images, images[0][:100]]) is None


def test_empty_table_has_no_instrument() -> None:
    background = learned_on("paper")
    found = segment_before(background, background, Prompts())
    assert not found.mask.any()
    assert found.confidence == 0


def test_wrong_background_is_refused() -> None:
    with pytest.raises(InputError, match=r"background: expected \(h, w, 3\) uint8, got \(4, 4\) uint8"):
        segment(drawn_on("paper")[0].image, background=np.zeros((4, 4), np.uint8))


@pytest.mark.parametrize("eye", ["left", "right"])
def test_real_bench_is_segmented(shared: Path, eye: str) -> None:
    paths = sorted((shared / "frames" / "bench" / "b" / "images" / eye).iterdir())
    settings = learned_backgrounds(SegmentSettings(), {eye: paths})
    for path in paths[5::40]:
        image = read_image(path)
        found = segment(image, background=settings.backgrounds[eye])
        alone = segment(image)
        assert min(found.confidence, alone.confidence) > 0.85 > GUESS
        both = found.mask & alone.mask
        assert both.sum() > 0.96 * (found.mask | alone.mask).sum()
