"""Files of Segment Anything 2 exports: the choice of the files in a folder, and the message for each unusable one."""

from __future__ import annotations

import importlib.util
import random
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.places import SCRIPTS
from helpers.sam2_graphs import FAMILIES, write_export

from dvrk_cmaes import DvrkCmaesError, InputError
from dvrk_cmaes.segment.sam2 import Sam2, open_export
from dvrk_cmaes.segment.segmentation import Hints

EXPECTED = "expected one encoder and one decoder exported by samexporter, onnxruntime, onnx-community or osam"
IMAGE = np.zeros((48, 64, 3), np.uint8)


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as error:
        Sam2(folder, threads=1)
    message = str(error.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("names", [("a.onnx", "b.onnx"), ("b.onnx", "a.onnx"), ("decoder.onnx", "encoder.onnx")])
def test_encoder_and_decoder_are_recognised_by_tensors(tmp_path: Path, family: str, names: tuple[str, str]) -> None:
    encoder, decoder = open_export(write_export(tmp_path, family, names=names), threads=1)
    assert (encoder.file.name, decoder.file.name) == names


def test_folder_without_model_is_refused(tmp_path: Path) -> None:
    nowhere = tmp_path / "nowhere"
    assert refusal(nowhere) == f"{nowhere}: expected the folder of an exported checkpoint, got no such folder"
    file = tmp_path / "model.onnx"
    file.write_bytes(b"")
    assert refusal(file) == f"{file}: expected the folder of an exported checkpoint, got a file"
    empty = tmp_path / "empty"
    empty.mkdir()
    assert refusal(empty) == f"{empty}: {EXPECTED}, got no .onnx file"


@pytest.mark.parametrize(
    ("kept", "there"),
    [
        ("first", "encoder"),
        ("second", "takes image_embeddings, high_res_features1, high_res_features2, point_coords, point_labels, ..."),
    ],
)
def test_incomplete_export_is_refused(tmp_path: Path, kept: str, there: str) -> None:
    write_export(tmp_path, "osam")
    (tmp_path / ("second.onnx" if kept == "first" else "first.onnx")).unlink()
    assert refusal(tmp_path) == f"{tmp_path}: {EXPECTED}, got {kept}.onnx ({there})"


@pytest.mark.parametrize("content", [b"", b"not a model", None], ids=["empty", "something else", "cut off"])
def test_damaged_model_is_named(tmp_path: Path, content: bytes | None) -> None:
    write_export(tmp_path, "samexporter")
    file = tmp_path / "second.onnx"
    file.write_bytes(file.read_bytes()[:3000] if content is None else content)
    assert refusal(tmp_path).startswith(
        f"{tmp_path}: {EXPECTED}, got first.onnx (encoder), second.onnx: expected a model (ONNX); onnxruntime "
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
            Sam2(tmp_path, threads=1).segment(IMAGE, Hints(box=(0, 0, 63, 47)))
        except DvrkCmaesError as error:
            messages.append(str(error))
        file.write_bytes(whole)
    assert 20 < len(messages) < 100
    assert [message for message in messages if len(message.splitlines()) != 1] == []
    assert capfd.readouterr() == ("", "")  # neither onnxruntime's own lines nor those of its retries


def test_missing_onnxruntime_is_reported_with_install_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "onnxruntime" else found(name))
    assert refusal(tmp_path) == (
        "model sam2: needs the library onnxruntime, which is not installed; "
        f"run: {sys.executable} -m pip install 'onnxruntime<2,>=1.22'"
    )
