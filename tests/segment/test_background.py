"""The instrument before a background that stands still, on drawings of a bench with known masks and on real images."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.drawn_tools import Drawing, draw_tool
from helpers.files import read_image, read_mask, write_image

from dvrk_cmaes import Camera, InputError, read_camera
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.runs.backgrounds import with_backgrounds
from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.background import foreground_log_odds, learn_background, segment_before
from dvrk_cmaes.segment.prompts import no_prompts
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
    assert isinstance(background, np.ndarray)
    background.setflags(write=False)
    return background


@pytest.mark.parametrize("ground", GROUNDS)
def test_moving_instrument_is_distinguished_from_what_stands_still(ground: str) -> None:
    for each in drawn_on(ground)[::8]:
        found = segment(each.image, background=learned_on(ground))
        assert each.overlap(found.mask) > 0.93
        assert found.confidence > 0.7


def test_learned_background_shows_no_instrument() -> None:
    drawn = drawn_on("textured cloth")
    free = np.stack([np.where(each.mask[..., None], np.nan, each.image.astype(float)) for each in drawn])
    assert np.abs(np.nanmedian(free, axis=0) - learned_on("textured cloth")).mean() < 3


def test_instrument_of_a_single_image_is_distinguished_from_a_smooth_background() -> None:
    for each in drawn_on("paper")[::8]:
        found = segment(each.image)
        assert found.before == "smooth background"
        assert each.overlap(found.mask) > 0.93
        assert found.confidence > 0.7


@pytest.mark.parametrize(("gain", "offset", "noise"), [(0.6, 0, 0), (1.4, 0, 0), (1.0, 30, 0), (0.8, 10, 5)])
def test_other_light_and_noise_change_little(gain: float, offset: float, noise: float) -> None:
    rng = np.random.default_rng(0)
    images = [
        np.clip(gain * each.image + offset + rng.normal(0, noise, each.image.shape), 0, 255).astype(np.uint8)
        for each in drawn_on("paper")[::2]
    ]
    learned = learn_background(images)
    assert isinstance(learned, np.ndarray) or noise
    background = learned if isinstance(learned, np.ndarray) else None
    for each, image in list(zip(drawn_on("paper")[::2], images, strict=True))[::4]:
        found = segment(image, background=background)
        assert each.overlap(found.mask) > 0.9


def test_instrument_on_tissue_is_found_by_colours_as_before() -> None:
    drawn = draw_tool(shadow=0.5, vignette=0.8, glare=15)
    found = segment(drawn.image)
    assert found.before is None
    assert drawn.overlap(found.mask) > 0.9


def test_background_that_moves_or_is_seen_too_seldom_is_not_learned() -> None:
    images = [each.image for each in drawn_on("textured cloth")]
    assert learn_background(images[:5]) == "5 images, fewer than 6"
    assert learn_background([images[0]] * 8) == "the images are alike: nothing moves before the camera"
    moved = learn_background([np.roll(image, 9 * k, axis=1) for k, image in enumerate(images)])
    assert isinstance(moved, str)
    assert "do not show the same scene" in moved
    assert learn_background([*images, images[0][:100]]) == "the images are of several sizes"


@pytest.mark.parametrize("count", [6, 16])
def test_images_shifted_by_some_pixels_are_registered(count: int) -> None:
    rng = np.random.default_rng(0)
    places = [np.float32([[1, 0, along], [0, 1, down]]) for along, down in rng.uniform(-1.2, 1.2, (16, 2))]
    drawn = [*zip(drawn_on("textured cloth"), places, strict=True)][:count]
    images = [
        cv2.warpAffine(each.image, place, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE) for each, place in drawn
    ]
    background = learn_background(images)
    assert isinstance(background, np.ndarray)
    for (each, place), image in list(zip(drawn, images, strict=True))[::8]:
        shown = cv2.warpAffine(each.mask.astype(np.uint8), place, (WIDTH, HEIGHT)) > 0
        found = segment(image, background=background).mask
        assert (found & shown).sum() > 0.9 * (found | shown).sum()


def test_what_is_the_same_in_all_images_is_a_guess() -> None:
    resting = draw_tool(shadow=0.5, vignette=0.8, glare=15).image  # would be found by its colours
    found = segment(resting, background=resting)
    assert segment(resting).confidence > GUESS > found.confidence
    assert "it looks like the background that the other images show" in found.notes


def test_empty_table_has_no_instrument() -> None:
    background = learned_on("paper")
    found = segment_before(background, foreground_log_odds(background, background), no_prompts(background.shape))
    assert not found.mask.any()
    assert found.confidence == 0


def pictures(paths: list[Path]) -> list[FrameFiles]:
    """Give frames that have images alone."""
    return [FrameFiles(path.stem, None, image=path) for path in paths]


def test_backgrounds_are_learned_where_the_scene_stands_still(tmp_path: Path) -> None:
    for name, drawn in (("bench", drawn_on("paper")), ("tissue", [draw_tool(seed=k) for k in range(8)])):
        for k, each in enumerate(drawn):
            write_image(tmp_path / name / f"{k}.png", each.image)
    paths = {name: sorted((tmp_path / name).iterdir()) for name in ("bench", "tissue")}
    (tmp_path / "bench" / "broken.png").write_bytes(b"no image")
    paths["bench"].append(tmp_path / "bench" / "broken.png")
    frames = {name: pictures(of_view) for name, of_view in paths.items()}
    settings = with_backgrounds(SegmentSettings(), frames)
    assert list(settings.backgrounds) == ["bench"]
    learned, not_learned = settings.notes
    assert learned == "images of bench: a background was learned from 17 of them"
    assert not_learned.startswith("images of tissue: no background was learned: the images do not show the same scene")
    assert not with_backgrounds(SegmentSettings("sam2"), frames).backgrounds


def test_frames_of_one_posture_show_no_background(tmp_path: Path) -> None:
    frames = []
    for k, each in enumerate(drawn_on("paper")):
        image = tmp_path / f"{k}.png"
        write_image(image, each.image)
        frames.append(FrameFiles(f"{k}", None, {"yaw": 0.1 * (k // 4), "insertion": 0.1}, image=image))
    settings = with_backgrounds(SegmentSettings(), {"": frames})
    assert not settings.backgrounds
    more = "12 more show the instrument in the same places, by their readings"
    assert settings.notes == (f"images: no background was learned: 4 images, fewer than 6; {more}",)


@pytest.fixture(scope="module")
def board(shared: Path) -> list[tuple[Drawing, dict[str, float]]]:
    """Frames before a printed board at a third of their size, with their readings."""
    found = []
    for files in read_session(shared / "frames" / "labs" / "berkeley").frames[:9]:
        assert files.image is not None
        assert files.mask is not None
        image, mask = read_image(files.image), read_mask(files.mask).astype(np.float32)
        small = (cv2.resize(each, (640, 360), interpolation=cv2.INTER_AREA) for each in (image, mask))
        found.append((Drawing(next(small), next(small) > 0.5), dict(files.readings)))
    return found


@pytest.fixture(scope="module")
def board_camera(shared: Path) -> Camera:
    return read_camera(shared / "frames" / "labs" / "berkeley" / "camera.yaml").scaled(640, 360)


def test_instrument_before_a_printed_board_is_found_with_readings_and_without(
    board: list[tuple[Drawing, dict[str, float]]], board_camera: Camera
) -> None:
    background = learn_background([drawn.image for drawn, _ in board])
    assert isinstance(background, np.ndarray)
    for (drawn, readings), read in ((board[1], True), (board[5], False)):
        given: dict[str, Any] = {"camera": board_camera, "joints": readings if read else None}
        assert drawn.overlap(segment(drawn.image, background=background, instrument="lnd", **given).mask) > 0.8


@pytest.mark.parametrize("kind", ["point", "box"])
def test_prompt_before_a_printed_board_does_not_fill_the_picture(
    board: list[tuple[Drawing, dict[str, float]]], board_camera: Camera, kind: str
) -> None:
    drawn, readings = board[7]
    v, u = np.nonzero(drawn.mask)
    given: dict[str, Any] = {"points": [(float(np.median(u)), float(np.median(v)))]}
    if kind == "box":
        given = {"box": (float(u.min()), float(v.min()), float(u.max()), float(v.max()))}
    found = segment(drawn.image, instrument="lnd", camera=board_camera, joints=readings, **given)
    assert found.mask.mean() < 0.3
    assert found.confidence < 0.6 or drawn.overlap(found.mask) > 0.7
    assert kind == "point" or drawn.overlap(found.mask) > 0.7


def test_wrong_background_is_refused() -> None:
    with pytest.raises(InputError, match=r"background: expected \(h, w, 3\) uint8, got \(4, 4\) uint8"):
        segment(drawn_on("paper")[0].image, background=np.zeros((4, 4), np.uint8))


def test_real_bench_is_segmented(shared: Path) -> None:
    paths = sorted((shared / "frames" / "bench" / "b" / "images" / "right").iterdir())[1::8]
    settings = with_backgrounds(SegmentSettings(), {"right": pictures(paths)})
    for path in paths[1::10]:
        image = read_image(path)
        found = segment(image, background=settings.backgrounds["right"])
        alone = segment(image)
        assert min(found.confidence, alone.confidence) > 0.85 > GUESS
        both = found.mask & alone.mask
        assert both.sum() > 0.96 * (found.mask | alone.mask).sum()
