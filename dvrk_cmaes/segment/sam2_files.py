"""Loading of the encoder and the decoder of a Segment Anything 2 export from a folder, independent of the file names.

Every model in the folder is opened and identified by the names of its tensors. One error says what each file is.
"""

from __future__ import annotations

import importlib.util
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
_INSTALL = "pip install 'onnxruntime>=1.22,<2'"


@dataclass(frozen=True, eq=False)
class OnnxModel:
    """An open model: its file, onnxruntime's session, the types of its inputs by name, and its outputs' names."""

    file: Path
    session: Any
    inputs: dict[str, str]
    outputs: list[str]

    def run(self, tensors: Tensors) -> list[NDArray[Any]]:
        """Run the model on its inputs among ``tensors``, converted to their declared types, and return its outputs.

        Raises
        ------
        DvrkCmaesError
            A type of an input is not known, or onnxruntime raises an error.
        """
        try:
            feeds = {name: tensors[name].astype(_DTYPES[kind], copy=False) for name, kind in self.inputs.items()}
            return [np.asarray(output) for output in self.session.run(None, feeds)]
        except Exception as error:  # onnxruntime's errors have no common base class
            raise DvrkCmaesError(f"{self.file}: the model failed: {one_line(error)}") from None

    def output(self, outputs: list[NDArray[Any]], key: str | int) -> NDArray[Any]:
        """Return one of the outputs of `run` by its name or position."""
        return outputs[self.outputs.index(key) if isinstance(key, str) else key]


@dataclass(frozen=True, eq=False)
class Export:
    """The encoder and the decoder of one export."""

    family: Family
    encoder: OnnxModel
    decoder: OnnxModel


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
    files = sorted(folder.glob("*.onnx")) or sorted(folder.glob("onnx/*.onnx"))
    if not files:
        raise InputError(f"{folder}: expected an exported checkpoint, got no .onnx file; {INSTEAD}")
    encoders, decoders, got = [], [], []
    for file in files:
        try:
            model = _open(file, threads)
        except InputError as error:
            got.append(str(error).removeprefix(f"{folder}/"))
            continue
        encoder = next((family for family in FAMILIES if _is_encoder(model, family)), None)
        decoder = next((family for family in FAMILIES if _is_decoder(model, family)), None)
        if encoder is not None:
            encoders.append((encoder, model))
            got.append(f"{file.name} (encoder of {encoder.name})")
        elif decoder is not None:
            decoders.append((decoder, model))
            got.append(f"{file.name} (decoder of {decoder.name})")
        else:
            got.append(f"{file.name}: neither encoder nor decoder of a known export (takes {listed(model.inputs)})")
    pairs = [(one, other) for one in encoders for other in decoders if one[0] is other[0]]
    if len(pairs) != 1:
        raise InputError(
            f"{folder}: expected one encoder and one decoder of an export, got {', '.join(got)}; {INSTEAD}"
        )
    (family, of_images), (_, of_prompts) = pairs[0]
    return Export(family, of_images, of_prompts)


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
        raise InputError(f"{file}: expected a model (ONNX); {said}") from None
    inputs = {tensor.name: tensor.type for tensor in session.get_inputs()}
    return OnnxModel(file, session, inputs, [tensor.name for tensor in session.get_outputs()])


def _named(names: Sequence[str], keys: Iterable[str | int]) -> bool:
    """Whether all these names and positions are among the tensors."""
    return all(key in names if isinstance(key, str) else key < len(names) for key in keys)


def _is_encoder(model: OnnxModel, family: Family) -> bool:
    if list(model.inputs) != [family.image] or not _named(model.outputs, family.encoded):
        return False
    by_position = any(isinstance(key, int) for key in family.encoded)
    return not by_position or len(model.outputs) == len(family.encoded)


def _is_decoder(model: OnnxModel, family: Family) -> bool:
    takes, needed = frozenset(model.inputs), family.decoder_inputs - family.optional
    return needed <= takes <= family.decoder_inputs and _named(model.outputs, family.outputs.values())
