"""Segment Anything 2 on models of all four export families with known output."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.sam2_graphs import ALL_IOUS, FAMILIES, REACH, TOOL, write_export

from dvrk_cmaes.segment import Segmentation, segment
from dvrk_cmaes.segment.sam2 import OnnxModel, Sam2, resize_logits
from dvrk_cmaes.segment.segmentation import Hints

SIZES = [(480, 640), (1080, 1920), (900, 300), (1024, 1024), (200, 150)]


@pytest.fixture(scope="module", params=FAMILIES)
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Sam2:
    return Sam2(write_export(tmp_path_factory.mktemp("export"), request.param), threads=1)


def picture(height: int = 480, width: int = 640) -> tuple[np.ndarray, np.ndarray]:
    """Give an image of a bar of the instrument's colour on tissue, and the bar's mask."""
    image = np.full((height, width, 3), (90, 90, 170), np.uint8)
    bar = np.zeros((height, width), bool)
    bar[height // 4 : height * 3 // 4, width // 10 : width * 9 // 10] = True
    image[bar] = TOOL[::-1]
    return image, bar


def near(pixel: tuple[float, float], shape: tuple[int, ...]) -> np.ndarray:
    """Give the mask of the pixels up to REACH from a pixel, measured in the encoder's square."""
    v, u = np.indices(shape[:2])
    return np.hypot((u - pixel[0]) * 1024 / shape[1], (v - pixel[1]) * 1024 / shape[0]) < REACH


def in_box(box: tuple[float, float, float, float], shape: tuple[int, ...]) -> np.ndarray:
    v, u = np.indices(shape[:2])
    return (u >= box[0]) & (u <= box[2]) & (v >= box[1]) & (v <= box[3])


def assert_alike(found: Segmentation, expected: np.ndarray) -> None:
    """Check that masks agree up to one decoder cell (4 of 1024 pixels) along the outline."""
    assert found.mask.shape == expected.shape
    assert found.mask.dtype == bool
    cell = np.ones([2 * int(np.ceil(4 * side / 1024)) + 1 for side in expected.shape], np.uint8)
    edge = cv2.dilate(expected.astype(np.uint8), cell) != cv2.erode(expected.astype(np.uint8), cell)
    assert expected.any()
    assert not (found.mask ^ expected)[~edge].any()


@pytest.mark.parametrize("size", SIZES)
def test_box_selects_instrument(model: Sam2, size: tuple[int, int]) -> None:
    image, bar = picture(*size)
    box = (size[1] * 0.3, size[0] * 0.2, size[1] * 0.6, size[0] * 0.6)
    found = model.segment(image, Hints(box=box))
    assert_alike(found, bar & in_box(box, size))
    assert found.confidence == pytest.approx(0.93)
    assert found.notes == ()


@pytest.mark.parametrize("size", SIZES)
def test_point_selects_instrument(model: Sam2, size: tuple[int, int]) -> None:
    image, bar = picture(*size)
    point = (size[1] * 0.3, size[0] * 0.5)
    assert_alike(model.segment(image, Hints(points=[point])), bar & near(point, size))


def inputs_of(tmp_path: Path, family: str, monkeypatch: pytest.MonkeyPatch, hints: Hints) -> dict[str, np.ndarray]:
    """Give the input tensors of a family's decoder for prompts in an image of 640 x 480 px."""
    heard: list[dict[str, np.ndarray]] = []
    run = OnnxModel.run
    monkeypatch.setattr(OnnxModel, "run", lambda model, tensors: heard.append(tensors) or run(model, tensors))
    Sam2(write_export(tmp_path, family), threads=1).segment(picture()[0], hints)
    return heard[-1]


def test_box_is_clipped_to_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tensors = inputs_of(tmp_path, "osam", monkeypatch, Hints(box=(-50, -50, 320, 900)))
    assert tensors["point_coords"].tolist() == [[[0, 0], [512, 1024]]]


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize(
    ("chosen", "ious", "share"),
    [((0, 1, 2), ALL_IOUS, "right"), ((1, 2, 0), (0.7, 0.2, 0.9), "all"), ((1,), (0.4,), "right")],
)
def test_mask_with_highest_predicted_overlap_is_chosen(
    tmp_path: Path, family: str, chosen: tuple[int, ...], ious: tuple[float, ...], share: str
) -> None:
    image, bar = picture()
    model = Sam2(write_export(tmp_path, family, chosen=chosen, ious=ious), threads=1)
    found = model.segment(image, Hints(box=(0, 0, 639, 479)))
    assert_alike(found, bar if share == "right" else np.ones_like(bar))
    assert found.confidence == pytest.approx(max(ious))


def test_classic_segmentation_gives_default_box_and_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image, bar = picture()
    guess = bar & (np.arange(640) < 300)
    monkeypatch.setattr("dvrk_cmaes.segment.classic.segment_classic", lambda *_, **__: Segmentation(guess, 0.6))
    found = segment(image, model="sam2", weights=write_export(tmp_path, "osam"), threads=1)
    assert_alike(found, guess | (bar & near((182, 240), bar.shape)))  # the middle of the guess
    assert found.confidence == 0.6
    assert found.notes == ("no prompt: asked by box and point of the classic segmentation (confidence 0.60)",)


def test_instrument_found_by_its_model_gives_default_prompts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image, bar = picture()
    by_model = Segmentation(bar & (np.arange(640) < 304), 0.7)
    monkeypatch.setattr("dvrk_cmaes.segment.model_masks.segment_by_model", lambda *_: by_model)
    weights = write_export(tmp_path, "osam")
    found = segment(image, model="sam2", weights=weights, threads=1, instrument="lnd")
    assert_alike(found, by_model.mask | (bar & near((184, 240), bar.shape)))
    assert found.confidence == 0.7


def test_prompt_is_passed_to_named_model(tmp_path: Path) -> None:
    image, bar = picture()
    box = (60, 0, 300, 479)
    found = segment(image, model="sam2", weights=write_export(tmp_path, "samexporter"), threads=1, box=box)
    assert_alike(found, bar & in_box(box, bar.shape))


def test_logits_are_interpolated_before_thresholding() -> None:
    ramp = np.tile(np.arange(256, dtype=np.float32) - 100.3, (256, 1))
    wide = resize_logits(ramp, (512, 2560))
    assert (wide[0] > 0).argmax() == np.ceil((100.3 + 0.5) * 10 - 0.5)
