"""Loading of the encoder and the decoder of a Segment Anything 2 export from a folder, independent of the file names.

Every model in the folder is opened and identified by the names of its tensors. One error says what each file is.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import DvrkCmaesError, InputError, one_line
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.short_text import listed, no_folder
from dvrk_cmaes.segment.sam2_exports import FAMILIES, Family, Tensors
from dvrk_cmaes.segment.sam2_images import SIDE

INSTEAD = (
    f"use an image encoder and decoder exported by {', '.join(family.name for family in FAMILIES[:-1])} "
    f"or {FAMILIES[-1].name}"
)
_DTYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}
_PRECISIONS = ("", "_fp16", "_quantized", "_int8", "_uint8", "_q4", "_q4f16", "_bnb4")  # suffixes, best first
_MOST_FILES = 8  # models in a folder that are opened
_INSTALL = "pip install 'onnxruntime>=1.22,<2'"


@dataclass(frozen=True, eq=False)
class OnnxModel:
    """An open model: its file, onnxruntime's session, and the types and shapes of its tensors by name, in order."""

    file: Path
    session: Any
    inputs: dict[str, tuple[str, list[int | str | None]]]
    outputs: dict[str, tuple[str, list[int | str | None]]]

    def run(self, tensors: Tensors) -> list[NDArray[Any]]:
        """Run the model on its inputs among ``tensors``, converted to their declared types, and return its outputs.

        Raises
        ------
        DvrkCmaesError
            onnxruntime raises an error.
        """
        feeds = {name: tensors[name].astype(_DTYPES[kind], copy=False) for name, (kind, _) in self.inputs.items()}
        try:
            return [np.asarray(output) for output in self.session.run(None, feeds)]
        except Exception as error:  # onnxruntime's errors have no common base class
            raise DvrkCmaesError(f"{self.file}: the model failed: {one_line(error)}") from None

    def output(self, outputs: list[NDArray[Any]], key: str | int) -> NDArray[Any]:
        """Return one of the outputs of `run` by its name or position."""
        return outputs[list(self.outputs).index(key) if isinstance(key, str) else key]


@dataclass(frozen=True, eq=False)
class Export:
    """The encoder and the decoder of one export, and notes about files of the folder that are not used."""

    family: Family
    encoder: OnnxModel
    decoder: OnnxModel
    notes: tuple[str, ...]


def open_export(folder: Path, threads: int) -> Export:
    """Open the encoder and the decoder in a folder, or in ``onnx/`` below it.

    Parameters
    ----------
    folder
        Folder of one export: two .onnx files, and the files of their weights if these are stored separately.
    threads
        Number of threads of each model.

    Raises
    ------
    InputError
        onnxruntime is not installed, the folder does not exist, or it has no pair that can be used; the message gives
        the reason and what to use instead.
    """
    if importlib.util.find_spec("onnxruntime") is None:
        raise InputError("model sam2: needs the library onnxruntime, which is not installed; run: " + _INSTALL)
    if not folder.is_dir():
        raise InputError(f"{folder}: expected the folder of an exported checkpoint, got {no_folder(folder)}")
    files = _models_in(folder) or _models_in(folder / "onnx")
    if not files:
        raise InputError(f"{folder}: expected an exported checkpoint, got no .onnx file; {INSTEAD}")
    if len(files) > _MOST_FILES:
        raise InputError(f"{folder}: expected one encoder and one decoder, got {len(files)} models; keep one pair")
    encoders: dict[str, list[OnnxModel]] = {}
    decoders: dict[str, list[OnnxModel]] = {}
    there, others = [], []
    for file in files:
        try:
            model = _open(file, threads)
        except InputError as error:
            others.append(str(error))
            continue
        for family in FAMILIES:
            role = "encoder" if _is_encoder(model, family) else "decoder" if _is_decoder(model, family) else None
            if role is not None:
                (encoders if role == "encoder" else decoders).setdefault(family.name, []).append(model)
                there.append(f"{file.name} ({role} of {family.name})")
                break
        else:
            others.append(f"{file}: neither encoder nor decoder of a known export (takes {listed(model.inputs)})")
    pairs = [family for family in FAMILIES if family.name in encoders and family.name in decoders]
    usable_encoders = [model for family in pairs for model in encoders[family.name]]
    usable_decoders = [model for family in pairs for model in _with_most_masks(decoders[family.name], family)]
    if len(usable_encoders) != 1 or len(usable_decoders) != 1:
        present = ", ".join([*there, *(reason.removeprefix(f"{folder}/") for reason in others)])
        raise InputError(f"{folder}: expected one encoder and one decoder of an export, got {present}; {INSTEAD}")
    notes = tuple(f"not used: {reason}" for reason in others)
    encoder, decoder = usable_encoders[0], usable_decoders[0]
    _check_inputs(encoder, decoder, pairs[0])
    return Export(pairs[0], encoder, decoder, notes)


def _models_in(folder: Path) -> list[Path]:
    """List the models of a folder, each in its best precision (model.onnx rather than model_int8.onnx)."""
    best: dict[str, tuple[int, Path]] = {}
    for file in sorted(folder.glob("*.onnx")):
        suffix = next((end for end in _PRECISIONS[1:] if file.stem.endswith(end)), "")
        rank = _PRECISIONS.index(suffix)
        stem = file.stem.removesuffix(suffix)
        if stem not in best or rank < best[stem][0]:
            best[stem] = (rank, file)
    return sorted(file for _, file in best.values())


def _open(file: Path, threads: int) -> OnnxModel:
    """Open one model; InputError if onnxruntime cannot read the file."""
    import onnxruntime

    onnxruntime.set_default_logger_severity(4)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4  # log fatal errors only: other errors are raised
    options.use_deterministic_compute = True
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # idle threads sleep
    check_file(file, expected="a model (ONNX)")
    try:
        session = onnxruntime.InferenceSession(  # a second try with the same provider would print lines to stdout
            str(file), options, providers=["CPUExecutionProvider"], enable_fallback=False
        )
    except Exception as error:  # onnxruntime's errors have no common base class
        said = f"onnxruntime {onnxruntime.__version__} does not read it: {one_line(error)}"
        if missing := re.search(r'External data path does not exist: "?([^"]+)"?|directory \[([^\]]+)\]', str(error)):
            said = f"its weights are missing: expected {Path(missing[1] or missing[2]).name} beside it"
        raise InputError(f"{file}: expected a model (ONNX); {said}") from None
    return OnnxModel(
        file,
        session,
        {tensor.name: (tensor.type, tensor.shape) for tensor in session.get_inputs()},
        {tensor.name: (tensor.type, tensor.shape) for tensor in session.get_outputs()},
    )


def _named(names: Sequence[str], keys: Iterable[str | int]) -> bool:
    """Whether all these names and positions are among the tensors."""
    return all(key in names if isinstance(key, str) else key < len(names) for key in keys)


def _is_encoder(model: OnnxModel, family: Family) -> bool:
    if list(model.inputs) != [family.image] or not _named(list(model.outputs), family.encoded):
        return False
    by_position = any(isinstance(key, int) for key in family.encoded)
    return not by_position or len(model.outputs) == len(family.encoded)


def _is_decoder(model: OnnxModel, family: Family) -> bool:
    takes, needed = frozenset(model.inputs), family.decoder_inputs - family.optional
    return needed <= takes <= family.decoder_inputs and _named(list(model.outputs), family.outputs.values())


def _with_most_masks(decoders: list[OnnxModel], family: Family) -> list[OnnxModel]:
    """Keep the decoders that return the largest number of candidate masks (three rather than one)."""
    if len(decoders) < 2:
        return decoders
    counts = []
    for decoder in decoders:
        key = family.outputs["overlaps"]
        _, shape = decoder.outputs[key] if isinstance(key, str) else list(decoder.outputs.values())[key]
        counts.append(shape[-1] if shape and isinstance(shape[-1], int) else 0)
    return [decoder for decoder, count in zip(decoders, counts, strict=True) if count == max(counts)]


def _check_inputs(encoder: OnnxModel, decoder: OnnxModel, family: Family) -> None:
    """Raise InputError for an encoder of another image size, or inputs of a type that is not supported."""
    _, shape = encoder.inputs[family.image]
    side = [length for length in shape[2:] if isinstance(length, int)]
    if len(shape) != 4 or any(length != SIDE for length in side):
        got = " x ".join(str(length) for length in shape)
        raise InputError(f"{encoder.file}: expected an encoder of 1 x 3 x {SIDE} x {SIDE} pixels, got {got}; {INSTEAD}")
    for model in (encoder, decoder):
        for name, (kind, _) in model.inputs.items():
            if kind not in _DTYPES:
                raise InputError(f"{model.file}: {name}: expected float32 or integers, got {kind}; {INSTEAD}")
