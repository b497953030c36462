"""What lies over all pictures of a recording: texts and a border are separated from what moves, and do not count."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from dvrk_cmaes import read_frame, read_session
from dvrk_cmaes.frames.overlays import overlaid, with_overlaid
from dvrk_cmaes.frames.session_folder import OVERLAID

Image = NDArray[np.uint8]
HEIGHT, WIDTH, IMAGES = 240, 320, 10


@cache
def tissue() -> Image:
    """A large picture of spots of every size."""
    noise = np.random.default_rng(0).standard_normal((2 * HEIGHT, 2 * WIDTH, 3)).astype(np.float32)
    spots = sum(cv2.GaussianBlur(noise, (0, 0), sigma) * 40 * sigma for sigma in (1.5, 6.0, 20.0))
    return np.asarray(np.clip(90 + spots, 0, 255), np.uint8)


def draw_text(image: Image) -> Image:
    cv2.putText(image, "PSM1 CLUTCH", (20, 200), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 255), 2)
    return image


LETTERS = draw_text(np.zeros((HEIGHT, WIDTH), np.uint8)) > 0
NEAR = cv2.dilate(LETTERS.astype(np.uint8), np.ones((25, 25), np.uint8)) > 0


def seen(number: int, *, moves: bool = True, text: bool = True, border: int = 0, held: bool = False) -> Image:
    """An image of a recording, compressed: tissue that moves, a text, a border, an instrument that is held still."""
    down, right = (17 * number, 23 * number) if moves else (0, 0)
    image = tissue()[down : down + HEIGHT, right : right + WIDTH].copy()
    image[:, WIDTH - border :] = 15
    if held:
        cv2.line(image, (WIDTH, 60), (200, 100), (230, 230, 230), 9)
    if text:
        draw_text(image)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def images(**what: bool | int) -> list[Image]:
    return [seen(number, **what) for number in range(IMAGES)]  # type: ignore[arg-type]


def test_text_is_found_and_little_else() -> None:
    found = overlaid(images())
    assert found is not None
    assert found[LETTERS].mean() > 0.95
    assert not found[~NEAR].any()


def test_without_a_text_there_is_nothing() -> None:
    assert overlaid(images(text=False)) is None
    assert overlaid(images()[:7]) is None


@pytest.mark.parametrize("masked", [False, True])
def test_instrument_that_is_held_still_is_no_text(masked: bool) -> None:
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.line(mask, (WIDTH, 60), (200, 100), 1, 9)
    assert overlaid(images(text=False, held=True), [mask > 0] * 3 if masked else []) is None


@pytest.mark.parametrize("size", [(HEIGHT, WIDTH), (HEIGHT // 2, WIDTH // 2)])
def test_frames_of_a_session_ignore_the_text_with_their_masks_and_without_images(
    tmp_path: Path, size: tuple[int, int]
) -> None:
    lens = {"K": [300.0, 0, 160, 0, 300.0, 120, 0, 0, 1], "D": [0.0] * 5}
    camera = {"image_width": WIDTH, "image_height": HEIGHT, **lens}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    mask = np.zeros(size, np.uint8)
    mask[:20, :30] = 255
    for folder in ("images", "masks"):
        (tmp_path / folder).mkdir()
    for number in range(IMAGES):
        cv2.imwrite(str(tmp_path / "images" / f"{number}.png"), seen(number))
        cv2.imwrite(str(tmp_path / "masks" / f"{number}.png"), mask)
    session = with_overlaid(read_session(tmp_path))
    assert OVERLAID in session.notes
    for files in (session.frames[0], replace(session.frames[0], image=None)):
        data = read_frame(files, session.rig)
        assert OVERLAID in data.notes
        assert data.ignore is not None
        assert data.ignore.shape == size
        step = WIDTH // size[1]
        assert data.ignore[LETTERS[::step, ::step]].mean() > 0.95
    part = replace(session.frames[0], mask=None, crop=(0, 160, 160, 80))
    cropped = read_frame(part, session.camera.cropped(0, 160, 160, 80)).ignore
    assert cropped is not None
    assert cropped[LETTERS[160:, :160]].mean() > 0.95
