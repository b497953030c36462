"""The classic segmentation, on drawings with known masks and on real frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.drawn_tools import DRAPE, TISSUE, Drawing, draw_tool
from helpers.files import read_image, read_mask

from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.segmentation import GUESS


@pytest.fixture(scope="module")
def drawing() -> Drawing:
    return draw_tool()


EVERYTHING = {"shadow": 0.5, "vignette": 0.8, "glare": 15}


@pytest.mark.parametrize(
    ("ground", "trap"),
    [
        (TISSUE, {"shadow": 0.55}),
        (TISSUE, {"vignette": 0.9}),
        (TISSUE, {"glare": 40}),
        (TISSUE, EVERYTHING),
        (DRAPE, EVERYTHING),
        ((60, 140, 70), EVERYTHING),
    ],
    ids=["shadow", "vignette", "glare", "tissue", "blue drape", "green drape"],
)
def test_instrument_is_found_without_prompt(ground: tuple[int, int, int], trap: dict[str, Any]) -> None:
    drawn = draw_tool(ground, **trap)
    found = segment(drawn.image)
    assert drawn.overlap(found.mask) >= 0.90
    assert found.confidence >= 0.7
    assert found.notes == ()


@pytest.mark.parametrize("times", [5])
def test_enlarged_image_gives_same_outline(drawing: Drawing, times: int) -> None:
    larger = drawing.enlarged(times)
    assert larger.overlap(segment(larger.image).mask) >= 0.9


def test_round_field_of_view(drawing: Drawing) -> None:
    drawn = drawing.in_round_picture(150)
    found = segment(drawn.image)
    assert drawn.overlap(found.mask) >= 0.88
    assert found.notes == ()


def test_dark_shaft_in_round_field_of_view() -> None:
    drawn = draw_tool()
    image = drawn.image.copy()
    shaft = drawn.mask & (np.indices(drawn.mask.shape)[1] < 165)
    image[shaft] = image[shaft] // 7
    drawn = Drawing(image, drawn.mask).in_round_picture(150)
    assert drawn.overlap(segment(drawn.image).mask) >= 0.85


def test_box_or_point_selects_one_of_two_instruments(drawing: Drawing) -> None:
    other = draw_tool(seed=3).mirrored()
    left, right = _two(drawing, other)
    for meant in (left, right):
        assert meant.overlap(segment(meant.image, box=meant.box).mask) >= 0.85
        u, v = (20, 114) if meant is left else (299, 114)
        assert meant.overlap(segment(meant.image, points=[(u, v)]).mask) >= 0.85


def _two(first: Drawing, second: Drawing) -> tuple[Drawing, Drawing]:
    """Give one image with short instruments from left and right, once with the mask of each."""
    gap = 320 // 2 - 30
    shifted = [
        Drawing(np.roll(d.image, s * gap, 1), np.roll(d.mask, s * gap, 1)) for d, s in ((first, -1), (second, 1))
    ]
    for one, kept in zip(shifted, (slice(0, 160), slice(160, 320)), strict=True):
        outside = np.ones(320, bool)
        outside[kept] = False
        one.mask[:, outside] = False
    image = np.concatenate([shifted[0].image[:, :160], shifted[1].image[:, 160:]], axis=1)
    return Drawing(image, shifted[0].mask), Drawing(image, shifted[1].mask)


def test_points_are_in_mask_and_not_points_are_not(drawing: Drawing) -> None:
    found = segment(drawing.image, points=[(60, 115)], not_points=[(60, 60), (200, 200)]).mask
    assert found[115, 60]
    assert not found[60, 60]
    assert not found[200, 200]
    assert drawing.overlap(found) >= 0.9
    assert not segment(drawing.image, not_points=[(230, 105)]).mask[105, 230]


@pytest.mark.parametrize(
    "image",
    [np.full((240, 320, 3), 90, np.uint8), np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)],
    ids=["even grey", "noise"],
)
def test_empty_image_gives_empty_mask(image: np.ndarray) -> None:
    found = segment(image)
    assert not found.mask.any()
    assert found.confidence == 0
    assert found.notes == ("no instrument found",)


def test_grey_object_away_from_border_is_a_guess(drawing: Drawing) -> None:
    image = draw_tool(seed=7).image
    image[:] = image[200:, 200:].mean(axis=(0, 1))
    cv2.circle(image, (160, 120), 40, (140, 140, 140), -1)
    found = segment(image)
    assert "the mask does not come in from the image's border, as instruments do" in found.notes
    assert found.confidence <= GUESS
    assert segment(image, points=[(160, 120)]).confidence > 0.9


def test_soft_grey_stain_is_a_guess() -> None:
    image = draw_tool().image
    image[:] = image[200:, 200:].mean(axis=(0, 1))
    stain = np.zeros(image.shape[:2], np.float32)
    stain[80:150, :170] = 0.8
    stain = cv2.GaussianBlur(stain, (0, 0), 22)[..., None]
    noise = np.random.default_rng(0).normal(0, 3, image.shape)
    found = segment(np.clip(image * (1 - stain) + 100 * stain + noise, 0, 255).astype(np.uint8))
    assert found.mask.any()
    assert found.confidence < GUESS
    assert found.notes == ("much of the mask's outline follows no edge in the image",)


@pytest.mark.parametrize("frame", ["easy/0026", "medium/0120", "medium/0290"])
def test_real_frames_are_segmented(shared: Path, frame: str) -> None:
    folder, name = frame.split("/")
    root = shared / "frames" / "real" / folder
    drawn = Drawing(read_image(root / "images" / f"{name}.png"), read_mask(root / "masks" / f"{name}.png"))
    assert drawn.overlap(segment(drawn.image, box=drawn.box).mask) >= 0.90
    assert drawn.overlap(segment(drawn.image).mask) >= 0.85
