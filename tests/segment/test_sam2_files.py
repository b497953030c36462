"""Files of Segment Anything 2 exports: the choice of the files in a folder, and the message for each unusable one."""

from __future__ import annotations

import importlib.util
import random
import re
from pathlib import Path

import numpy as np
import onnx
import onnx.parser
import onnxruntime
import pytest
from helpers.places import SCRIPTS
from helpers.sam2_graphs import FAMILIES, decoder, encoder, write_export

from dvrk_cmaes import DvrkCmaesError, InputError
from dvrk_cmaes.segment.sam2 import Sam2
from dvrk_cmaes.segment.sam2_files import open_export

INSTEAD = "use an image encoder and decoder exported by samexporter, onnxruntime, onnx-community or osam"
IMAGE = np.zeros((48, 64, 3), np.uint8)


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as error:
        Sam2(folder, threads=1)
    message = str(error.value)
    assert "\n" not in message
    return message


def foreign(inputs: str) -> onnx.ModelProto:
    """Make a model of no known family with these inputs; it is not run."""
    body = "{ y = Constant<value = float[1] {0}>() }"
    return onnx.parser.parse_model(f'<ir_version: 8, opset_import: ["" : 17]> g ({inputs}) => (float[1] y) {body}')


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("names", [("a.onnx", "b.onnx"), ("b.onnx", "a.onnx"), ("decoder.onnx", "encoder.onnx")])
def test_encoder_and_decoder_are_recognised_by_tensors(tmp_path: Path, family: str, names: tuple[str, str]) -> None:
    export = open_export(write_export(tmp_path, family, names=names), threads=1)
    assert export.family.name == family
    assert (export.encoder.file.name, export.decoder.file.name) == names
    assert export.notes == ()


def test_models_may_be_in_onnx_subfolder(tmp_path: Path) -> None:
    write_export(tmp_path / "onnx", "onnx-community")
    assert open_export(tmp_path, threads=1).encoder.file == tmp_path / "onnx" / "first.onnx"


def test_full_precision_is_preferred(tmp_path: Path) -> None:
    write_export(tmp_path, "onnx-community", names=("vision_encoder.onnx", "prompt_encoder_mask_decoder_fp16.onnx"))
    for suffix in ("_fp16", "_int8", "_q4f16", "_quantized"):
        (tmp_path / f"vision_encoder{suffix}.onnx").write_bytes(b"damaged")
    (tmp_path / "prompt_encoder_mask_decoder_q4.onnx").write_bytes(b"damaged")
    export = open_export(tmp_path, threads=1)
    assert export.encoder.file.name == "vision_encoder.onnx"
    assert export.decoder.file.name == "prompt_encoder_mask_decoder_fp16.onnx"
    assert export.notes == ()


def test_decoder_with_more_masks_is_preferred(tmp_path: Path) -> None:
    write_export(tmp_path, "onnxruntime")
    for name, count in (("one.onnx", 1), ("multi.onnx", 3)):
        model = decoder("onnxruntime", ious=(0.5,) * count, chosen=tuple(range(count)))
        model.graph.output[1].type.tensor_type.shape.dim[1].dim_value = count
        onnx.save(model, tmp_path / name)
    (tmp_path / "second.onnx").unlink()
    assert open_export(tmp_path, threads=1).decoder.file.name == "multi.onnx"


def test_unused_model_is_noted(tmp_path: Path) -> None:
    write_export(tmp_path, "samexporter")
    onnx.save(foreign("float[1] memory"), tmp_path / "memory_attention.onnx")
    found = Sam2(tmp_path, threads=1).segment(IMAGE, points=[(3, 3)])
    assert found.notes[-1] == (
        f"not used: {tmp_path}/memory_attention.onnx: a part of a video export, "
        "which needs the memory of earlier frames"
    )


def test_folder_without_model_is_refused(tmp_path: Path) -> None:
    nowhere = tmp_path / "nowhere"
    assert refusal(nowhere) == f"{nowhere}: expected the folder of an exported checkpoint, got no such folder"
    file = tmp_path / "model.onnx"
    file.write_bytes(b"")
    assert refusal(file) == f"{file}: expected the folder of an exported checkpoint, got a file"
    empty = tmp_path / "empty"
    empty.mkdir()
    assert refusal(empty) == f"{empty}: expected an exported checkpoint, got no .onnx file; {INSTEAD}"


@pytest.mark.parametrize(("kept", "missing"), [("first", "decoder"), ("second", "encoder")])
def test_incomplete_export_is_refused(tmp_path: Path, kept: str, missing: str) -> None:
    write_export(tmp_path, "osam")
    (tmp_path / ("second.onnx" if kept == "first" else "first.onnx")).unlink()
    there = "decoder" if missing == "encoder" else "encoder"
    assert refusal(tmp_path) == (
        f"{tmp_path}: no {missing}: expected encoder and decoder of one export, got {kept}.onnx ({there} of osam)"
    )


def test_parts_of_two_exports_are_refused(tmp_path: Path) -> None:
    onnx.save(encoder("samexporter"), tmp_path / "e.onnx")
    onnx.save(decoder("onnxruntime"), tmp_path / "d.onnx")
    assert refusal(tmp_path) == (
        f"{tmp_path}: expected encoder and decoder of one export, "
        "got e.onnx (encoder of samexporter), d.onnx (decoder of onnxruntime)"
    )


def test_video_export_is_refused(tmp_path: Path) -> None:
    onnx.save(encoder("samexporter"), tmp_path / "image_encoder.onnx")
    onnx.save(foreign("float[1] pix_feat, float[1] mask_for_mem"), tmp_path / "memory_encoder.onnx")
    assert refusal(tmp_path) == (
        f"{tmp_path}: no decoder: expected encoder and decoder of one export, got image_encoder.onnx (encoder of "
        "samexporter), memory_encoder.onnx: a part of a video export, which needs the memory of earlier frames; "
        f"{INSTEAD}"
    )


def test_two_model_sizes_are_refused(tmp_path: Path) -> None:
    write_export(tmp_path, "samexporter", names=("tiny.encoder.onnx", "tiny.decoder.onnx"))
    write_export(tmp_path, "samexporter", names=("large.encoder.onnx", "large.decoder.onnx"))
    assert refusal(tmp_path) == (
        f"{tmp_path}: expected one encoder and one decoder, got the encoders large.encoder.onnx, tiny.encoder.onnx "
        "and the decoders large.decoder.onnx, tiny.decoder.onnx; keep one pair"
    )


def test_too_many_models_are_refused_unopened(tmp_path: Path) -> None:
    for k in range(9):
        (tmp_path / f"{k}.onnx").write_bytes(b"")
    assert refusal(tmp_path) == f"{tmp_path}: expected one encoder and one decoder, got 9 models; keep one pair"


@pytest.mark.parametrize("content", [b"", b"not a model", None], ids=["empty", "something else", "cut off"])
def test_damaged_model_is_named(tmp_path: Path, content: bytes | None) -> None:
    write_export(tmp_path, "samexporter")
    file = tmp_path / "second.onnx"
    file.write_bytes(file.read_bytes()[:3000] if content is None else content)
    assert refusal(tmp_path) == (
        f"{tmp_path}: no decoder: expected encoder and decoder of one export, got first.onnx (encoder of samexporter), "
        "second.onnx: expected a model, got a file that is damaged, cut off or something else; download it again"
    )


def test_models_with_damaged_bytes_are_refused_in_one_line_or_run(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    from fuzzing.damage import damaged_bytes

    write_export(tmp_path, "samexporter")
    messages = []
    for number in range(100):
        chance = random.Random(number)
        file = chance.choice(sorted(tmp_path.glob("*.onnx")))
        whole = file.read_bytes()
        file.write_bytes(damaged_bytes(whole, chance))
        try:
            Sam2(tmp_path, threads=1).segment(IMAGE, box=(0, 0, 63, 47))
        except DvrkCmaesError as error:
            messages.append(str(error))
        file.write_bytes(whole)
    assert 20 < len(messages) < 100
    assert [message for message in messages if len(message.splitlines()) != 1] == []
    assert capfd.readouterr() == ("", "")  # neither onnxruntime's own lines nor those of its retries


def only(tmp_path: Path, model: onnx.ModelProto) -> str:
    """Give the message for a folder with this one model, without the file's name and the advice at the end."""
    onnx.save(model, tmp_path / "one.onnx")
    message = refusal(tmp_path)
    assert message.startswith(f"{tmp_path}/one.onnx: ")
    assert message.endswith(f"; {INSTEAD}")
    return message.removeprefix(f"{tmp_path}/one.onnx: ").removesuffix(f"; {INSTEAD}")


def test_git_lfs_pointer_is_refused(tmp_path: Path) -> None:
    (tmp_path / "one.onnx").write_bytes(b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n")
    assert refusal(tmp_path) == (
        f"{tmp_path}/one.onnx: expected a model, got only Git LFS's pointer to it; "
        "download the file itself (git lfs pull)"
    )


def test_missing_weights_file_is_named(tmp_path: Path) -> None:
    write_export(tmp_path, "onnx-community")
    onnx.save(
        encoder("onnx-community"),
        tmp_path / "first.onnx",
        save_as_external_data=True,
        location="first.onnx_data",
        size_threshold=0,
    )
    assert open_export(tmp_path, threads=1).encoder.file == tmp_path / "first.onnx"
    (tmp_path / "first.onnx_data").unlink()
    assert refusal(tmp_path) == (
        f"{tmp_path}: no encoder: expected encoder and decoder of one export, got second.onnx (decoder of "
        "onnx-community), first.onnx: its weights are missing: expected first.onnx_data beside it; "
        "download that file too"
    )


@pytest.mark.parametrize("field", ["opset", "ir"])
def test_model_for_newer_runtime_is_refused(tmp_path: Path, field: str) -> None:
    model = foreign("float[1] x")
    if field == "opset":
        model.opset_import[0].version = 99
    else:
        model.ir_version = 99
    onnx.save(model, tmp_path / "one.onnx")
    assert refusal(tmp_path) == (
        f"{tmp_path}/one.onnx: made for a newer onnxruntime than the {onnxruntime.__version__} installed; "
        "pip install --upgrade onnxruntime"
    )


@pytest.mark.parametrize(
    ("inputs", "meaning"),
    [
        (
            "float[1, 8] current_features, float[7, 8] memory",
            "a part of a video export, which needs the memory of earlier frames",
        ),
        (
            "float[1] image_embeddings, float[1] sparse_prompt_embeddings",
            "a part of an export that keeps prompts and masks in files of their own",
        ),
        ("float[1] image_embeddings, float[1] point_coords", "a part of an export of the first Segment Anything"),
        ("float[1] x, float[1] z", "neither encoder nor decoder of a known export (takes x, z)"),
    ],
)
def test_parts_of_other_exports_are_recognised(tmp_path: Path, inputs: str, meaning: str) -> None:
    assert only(tmp_path, foreign(inputs)) == meaning


def test_decoder_with_other_inputs_is_refused(tmp_path: Path) -> None:
    inputs = (
        "float[1] image_embed, float[1] high_res_feats_0, float[1] high_res_feats_1, float[1] point_coords, "
        "float[1] point_labels, float[1] mask_input, float[1] frame_index"
    )
    assert only(tmp_path, foreign(inputs)) == (
        "like a decoder of samexporter, but it wants frame_index besides and has no has_mask_input"
    )


def test_encoder_of_other_size_is_refused(tmp_path: Path) -> None:
    write_export(tmp_path, "onnx-community")
    model = encoder("onnx-community")
    for dim in model.graph.input[0].type.tensor_type.shape.dim[2:]:
        dim.dim_value = 1008
    for output in model.graph.output:
        output.type.tensor_type.shape.ClearField("dim")
        output.type.tensor_type.ClearField("shape")
    onnx.save(model, tmp_path / "first.onnx")
    assert refusal(tmp_path) == (
        f"{tmp_path}/first.onnx: expected an encoder of 1 x 3 x 1024 x 1024 pixels, got 1 x 3 x 1008 x 1008; {INSTEAD}"
    )


def test_encoder_of_raw_pixels_is_refused(tmp_path: Path) -> None:
    write_export(tmp_path, "samexporter")
    model = encoder("samexporter")
    model.graph.input[0].type.tensor_type.elem_type = onnx.TensorProto.UINT8
    wide = onnx.helper.make_node("Cast", ["image"], ["wide"], to=onnx.TensorProto.FLOAT)
    for node in model.graph.node:
        node.input[:] = ["wide" if name == "image" else name for name in node.input]
    model.graph.node.insert(0, wide)
    onnx.save(model, tmp_path / "first.onnx")
    assert refusal(tmp_path) == (
        f"{tmp_path}/first.onnx: image: expected float32 or integers, got tensor(uint8); {INSTEAD}"
    )


def test_non_finite_output_is_refused(tmp_path: Path) -> None:
    model = Sam2(write_export(tmp_path, "samexporter", ious=(0.1, float("nan"), 0.2)), threads=1)
    message = f"{tmp_path}/second.onnx: the model returned values that are not finite; use an export in float32"
    with pytest.raises(DvrkCmaesError, match=f"^{re.escape(message)}$"):
        model.segment(IMAGE, points=[(3, 3)])


def test_number_of_masks_must_match_overlaps(tmp_path: Path) -> None:
    model = Sam2(write_export(tmp_path, "samexporter", ious=(0.1, 0.2)), threads=1)
    message = f"{tmp_path}/second.onnx: expected 2 masks, as many as overlaps, got an array of 1 x 3 x 256 x 256"
    with pytest.raises(DvrkCmaesError, match=f"^{re.escape(message)}$"):
        model.segment(IMAGE, points=[(3, 3)])


def test_failing_model_is_named(tmp_path: Path) -> None:
    write_export(tmp_path, "samexporter")
    model = decoder("samexporter")
    model.graph.input[0].type.tensor_type.shape.dim[1].dim_value = 31
    onnx.save(model, tmp_path / "second.onnx")
    with pytest.raises(DvrkCmaesError) as error:
        Sam2(tmp_path, threads=1).segment(IMAGE, points=[(3, 3)])
    assert str(error.value).startswith(f"{tmp_path}/second.onnx: the model failed: [ONNXRuntimeError]")
    assert "\n" not in str(error.value)


def test_missing_onnxruntime_is_reported_with_install_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "onnxruntime" else found(name))
    assert refusal(tmp_path) == (
        "model sam2: needs the library onnxruntime, which is not installed; run: pip install 'onnxruntime>=1.22,<2'"
    )


def test_number_of_threads_is_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^threads: expected a whole number of at least 1, got 0$"):
        Sam2(tmp_path, threads=0)
