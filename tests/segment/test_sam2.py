"""Segment Anything 2 on models of all four export families with known output."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from helpers.sam2_graphs import ALL_IOUS, FAMILIES, REACH, TOOL, decoder, write_export
from onnx import helper

from dvrk_cmaes import InputError
from dvrk_cmaes.segment import Segmentation, segment
from dvrk_cmaes.segment.sam2 import Sam2
from dvrk_cmaes.segment.sam2_files import OnnxModel
from dvrk_cmaes.segment.sam2_images import encoder_input, resize_logits

SIZES = [(480, 640), (1080, 1920), (900, 300), (1024, 1024), (200, 150)]


@pytest.fixture(scope="module", params=FAMILIES)
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Sam2:
    return Sam2(write_export(tmp_path_factory.mktemp("export"), request.param), threads=1)


@pytest.fixture
def one_model(tmp_path: Path) -> Sam2:
    return Sam2(write_export(tmp_path, "osam"), threads=1)


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
    found = model.segment(image, box=box)
    assert_alike(found, bar & in_box(box, size))
    assert found.confidence == pytest.approx(0.93)
    assert found.notes == ()


@pytest.mark.parametrize("size", SIZES)
def test_point_selects_instrument(model: Sam2, size: tuple[int, int]) -> None:
    image, bar = picture(*size)
    point = (size[1] * 0.3, size[0] * 0.5)
    assert_alike(model.segment(image, points=[point]), bar & near(point, size))


def test_points_and_not_points_are_combined(model: Sam2) -> None:
    image, bar = picture()
    on, beside = [(150.0, 200.0), (480.0, 300.0)], [(250.0, 220.0), (560.0, 300.0)]
    expected = bar & (near(on[0], bar.shape) | near(on[1], bar.shape))
    expected &= ~near(beside[0], bar.shape) & ~near(beside[1], bar.shape)
    assert_alike(model.segment(image, points=on, not_points=beside), expected)


def test_box_and_points_are_combined(model: Sam2) -> None:
    image, bar = picture()
    box, on, beside = (60.0, 100.0, 200.0, 400.0), (450.0, 240.0), (90.0, 140.0)
    expected = bar & (in_box(box, bar.shape) | near(on, bar.shape)) & ~near(beside, bar.shape)
    assert_alike(model.segment(image, box=box, points=[on], not_points=[beside]), expected)


def told(tmp_path: Path, family: str, monkeypatch: pytest.MonkeyPatch, **prompts: object) -> dict[str, np.ndarray]:
    """Give the input tensors of a family's decoder for prompts in an image of 640 x 480 px."""
    heard: list[dict[str, np.ndarray]] = []
    run = OnnxModel.run
    monkeypatch.setattr(OnnxModel, "run", lambda model, tensors: heard.append(tensors) or run(model, tensors))
    Sam2(write_export(tmp_path, family), threads=1).segment(picture()[0], **prompts)  # type: ignore[arg-type]
    return heard[-1]


@pytest.mark.parametrize("family", ["samexporter", "onnxruntime", "osam"])
def test_box_corners_are_points_labelled_2_and_3(tmp_path: Path, family: str, monkeypatch: pytest.MonkeyPatch) -> None:
    tensors = told(tmp_path, family, monkeypatch, box=(64, 48, 320, 240), points=[(160, 120)], not_points=[(480, 360)])
    expected = [[102.4, 102.4], [512, 512], [256, 256], [768, 768]]
    assert tensors["point_coords"][0] == pytest.approx(np.array(expected), abs=1e-3)
    assert tensors["point_labels"].tolist() == [[2, 3, 1, 0]]


def test_separate_box_input_and_empty_prompts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tensors = told(tmp_path / "box", "onnx-community", monkeypatch, box=(64, 48, 320, 240))
    assert tensors["input_boxes"] == pytest.approx(np.array([[[102.4, 102.4, 512, 512]]]), abs=1e-3)
    assert tensors["input_points"].shape == (1, 1, 0, 2)
    assert tensors["input_labels"].shape == (1, 1, 0)
    tensors = told(tmp_path / "point", "onnx-community", monkeypatch, points=[(160, 120)])
    assert tensors["input_boxes"].shape == (1, 0, 4)
    assert tensors["input_points"].tolist() == [[[[256, 256]]]]
    assert tensors["input_labels"].tolist() == [[[1]]]


@pytest.mark.parametrize(("family", "name"), [("onnxruntime", "original_image_size"), ("osam", "orig_im_size")])
def test_image_size_is_height_and_width(
    tmp_path: Path, family: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert told(tmp_path, family, monkeypatch, points=[(160, 120)])[name].tolist() == [480, 640]


def test_box_is_clipped_to_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tensors = told(tmp_path, "osam", monkeypatch, box=(-50, -50, 320, 900))
    assert tensors["point_coords"].tolist() == [[[0, 0], [512, 1024]]]


def test_binary_masks_of_model_are_used_unchanged(tmp_path: Path) -> None:
    folder = write_export(tmp_path, "onnxruntime")
    model = decoder("onnxruntime")
    last = next(node for node in model.graph.node if node.output[0] == "masks")
    last.op_type = "Less"
    onnx.save(model, folder / "second.onnx")
    image, bar = picture()
    assert_alike(Sam2(folder, 1).segment(image, box=(0, 0, 639, 479)), ~bar)


def test_score_is_probability_of_mask(model: Sam2) -> None:
    image, _ = picture()
    found = model.segment(image, points=[(300, 240)])
    assert found.score is not None
    assert found.score.dtype == np.float32
    assert found.score.min() >= 0
    assert found.score.max() <= 1
    assert np.mean((found.score > 0.5) == found.mask) > 0.9999


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
    found = model.segment(image, box=(0, 0, 639, 479))
    assert_alike(found, bar if share == "right" else np.ones_like(bar))
    assert found.confidence == pytest.approx(max(ious))


def test_confidence_is_at_most_one(tmp_path: Path) -> None:
    model = Sam2(write_export(tmp_path, "osam", ious=(0.2, 1.04, 0.3)), threads=1)
    assert model.segment(picture()[0], points=[(300, 240)]).confidence == 1


def test_empty_mask_is_noted(tmp_path: Path) -> None:
    model = Sam2(write_export(tmp_path, "samexporter", ious=(0.1, 0.2, 0.9)), threads=1)
    found = model.segment(picture()[0], points=[(300, 240)])
    assert found.confidence == 0
    assert found.notes == ("the model found nothing at the prompt",)


def test_low_object_presence_lowers_confidence(tmp_path: Path) -> None:
    model = Sam2(write_export(tmp_path, "onnx-community", presence=-2.0), threads=1)
    found = model.segment(picture()[0], points=[(300, 240)])
    assert found.confidence == pytest.approx(1 / (1 + np.exp(2)))
    assert found.notes == ("the model doubts that there is an object at the prompt (probability 0.12)",)


def test_image_is_encoded_once_for_several_prompts(one_model: Sam2, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr("dvrk_cmaes.segment.sam2.encoder_input", lambda im: seen.append(1) or encoder_input(im))
    image, bar = picture()
    one_model.segment(image, points=[(100, 240)])
    one_model.segment(image.copy(), points=[(500, 240)])
    assert len(seen) == 1
    image[:, :320] = 0
    assert_alike(one_model.segment(image, box=(0, 0, 639, 479)), bar & (np.arange(640) >= 320))
    assert len(seen) == 2
    one_model.segment(image.reshape(640, 480, 3), points=[(100, 240)])
    assert len(seen) == 3


def test_result_does_not_depend_on_threads(tmp_path: Path) -> None:
    folder = write_export(tmp_path, "onnxruntime")
    image, _ = picture()
    one, two = (Sam2(folder, threads).segment(image, box=(50, 80, 400, 300)) for threads in (1, 2))
    assert np.array_equal(one.score, two.score)


def test_half_precision_exports_get_declared_types(tmp_path: Path) -> None:
    folder = write_export(tmp_path, "onnx-community")
    model = decoder("onnx-community")
    for value in model.graph.input:
        if value.type.tensor_type.elem_type == onnx.TensorProto.FLOAT:
            value.type.tensor_type.elem_type = onnx.TensorProto.FLOAT16
            wide = f"{value.name} wide"
            for node in model.graph.node:
                node.input[:] = [wide if name == value.name else name for name in node.input]
            model.graph.node.insert(0, helper.make_node("Cast", [value.name], [wide], to=onnx.TensorProto.FLOAT))
    onnx.save(model, folder / "second.onnx")
    image, bar = picture()
    assert_alike(Sam2(folder, 1).segment(image, box=(60, 0, 300, 479)), bar & in_box((60, 0, 300, 479), bar.shape))


def test_older_exports_get_image_size(tmp_path: Path) -> None:
    folder = write_export(tmp_path, "samexporter")
    model = decoder("samexporter")
    model.graph.input.append(helper.make_tensor_value_info("orig_im_size", onnx.TensorProto.INT32, [2]))
    onnx.save(model, folder / "second.onnx")
    image, bar = picture()
    assert_alike(Sam2(folder, 1).segment(image, points=[(300, 240)]), bar & near((300, 240), bar.shape))


def test_prompt_is_required(one_model: Sam2) -> None:
    image, _ = picture()
    message = "^prompt: Segment Anything 2 needs a box or a point on the instrument, got neither$"
    with pytest.raises(InputError, match=message):
        one_model.segment(image)
    with pytest.raises(InputError, match=message):
        one_model.segment(image, not_points=[(3, 3)])
    with pytest.raises(InputError, match=r"^point: expected a pixel of the 640 x 480 image, got 700,3$"):
        one_model.segment(image, points=[(700, 3)])


def test_classic_segmentation_gives_default_box_and_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image, bar = picture()
    guess = bar & (np.arange(640) < 300)
    monkeypatch.setattr("dvrk_cmaes.segment.classic.segment_classic", lambda *_, **__: Segmentation(guess, None, 0.6))
    found = segment(image, model="sam2", weights=write_export(tmp_path, "osam"), threads=1)
    assert_alike(found, guess | (bar & near((182, 240), bar.shape)))  # the middle of the guess
    assert found.confidence == 0.6
    assert found.notes == ("no prompt: asked by box and point of the classic segmentation (confidence 0.60)",)


def test_instrument_found_by_its_model_gives_default_prompts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image, bar = picture()
    by_model = Segmentation(bar & (np.arange(640) < 304), None, 0.7)
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


def test_encoder_input_is_normalised_rgb() -> None:
    image = np.full((48, 64, 3), (0, 128, 255), np.uint8)
    values = encoder_input(image)
    assert values.shape == (1, 3, 1024, 1024)
    assert values.dtype == np.float32
    expected = [(1 - 0.485) / 0.229, (128 / 255 - 0.456) / 0.224, (0 - 0.406) / 0.225]
    assert values[0, :, 500, 500] == pytest.approx(expected, abs=1e-5)
    assert np.ptp(values, axis=(2, 3)) == pytest.approx(0, abs=1e-6)


def test_large_images_are_averaged() -> None:
    stripes = np.zeros((1024, 2048, 3), np.uint8)
    stripes[:, ::2] = 255
    assert np.ptp(encoder_input(stripes), axis=(2, 3)) == pytest.approx(0, abs=1e-5)
    assert encoder_input(stripes)[0, :, 0, 0] == pytest.approx(
        [(0.5 - 0.485) / 0.229, (0.5 - 0.456) / 0.224, (0.5 - 0.406) / 0.225], abs=1e-5
    )


def test_logits_are_interpolated_before_thresholding() -> None:
    ramp = np.tile(np.arange(256, dtype=np.float32) - 100.3, (256, 1))
    wide = resize_logits(ramp, (512, 2560))
    assert (wide[0] > 0).argmax() == np.ceil((100.3 + 0.5) * 10 - 0.5)
