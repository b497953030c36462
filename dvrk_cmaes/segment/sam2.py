"""Segmentation by Segment Anything 2, from exported model files provided by the user.

An export consists of two files: an encoder, run once an image, and a decoder, run once a prompt. The decoder returns a
few candidate masks, each with a predicted overlap (IoU) with the true mask; the candidate with the largest predicted
overlap is used. Exporters differ in the names of the tensors, and each decoder is given those that it takes of all that
are known:

- samexporter: `samexporter/export_sam2.py` and `sam2_onnx.py`; older versions also take ``orig_im_size``.
- onnxruntime: `onnxruntime/python/tools/transformers/models/sam2/image_decoder.py`; returns boolean masks, and logits.
- onnx-community: `Sam2Model.forward` in transformers.js (a box in ``input_boxes``; where there is no point, or no box,
  an empty tensor).
- osam: `osam/_models/sam2` (outputs are identified by position).

Every image is resized to a square of 1024 pixels, whatever its aspect ratio. Prompts are scaled in the same way, to
u 1024 / width and v 1024 / height, x before y, as in the model's own predictor (`SAM2Transforms` and
`SAM2ImagePredictor` in facebookresearch/sam2); every export adds half a pixel itself before it normalises them. Mask
logits are interpolated to the image's size before they are thresholded: thresholding first would leave the steps of a
256-pixel mask in the outline.
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import DvrkCmaesError, InputError, missing_library, one_line
from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.geometry import Float32
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.short_text import listed, no_folder
from dvrk_cmaes.segment.regions import distance_to
from dvrk_cmaes.segment.segmentation import Hints, Segmentation, check_prompts

Tensors = dict[str, NDArray[Any]]

SIDE: Final = 1024
"""Side of the encoder's square, px."""
_MEAN: Final = np.array([0.485, 0.456, 0.406], np.float32)  # of ImageNet, RGB, for values from 0 to 1
_DEVIATION: Final = np.array([0.229, 0.224, 0.225], np.float32)
_ON, _OFF, _BOX_START, _BOX_END = 1, 0, 2, 3  # labels of points; -1 is padding, which the graphs append
_BY_POSITION: Final = "image_embeddings", "high_res_features1", "high_res_features2"
"""Inputs of osam's decoder, in the order of its encoder's outputs, whose names differ between files."""
_MASKS, _OVERLAPS = ("low_res_masks", "pred_masks", "masks"), ("iou_predictions", "iou_scores")
_PRESENCE: Final = "object_score_logits"
_DTYPES: Final = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}
_EXPECTED: Final = "expected one encoder and one decoder exported by samexporter, onnxruntime, onnx-community or osam"


@dataclass(frozen=True, eq=False)
class OnnxModel:
    """An open model: its file, onnxruntime's session, the types of its inputs by name, and its outputs' names."""

    file: Path
    session: Any
    inputs: dict[str, str]
    outputs: list[str]

    @property
    def is_encoder(self) -> bool:
        """Whether the model takes an image alone and returns its features."""
        return len(self.inputs) == 1 and len(self.outputs) >= len(_BY_POSITION)

    def run(self, tensors: Tensors) -> Tensors:
        """Run the model on its inputs among ``tensors``, converted to their declared types; returns outputs by name.

        Raises
        ------
        DvrkCmaesError
            A type of an input is not known, or onnxruntime raises an error.
        """
        try:
            feeds = {name: tensors[name].astype(_DTYPES[kind], copy=False) for name, kind in self.inputs.items()}
            outputs = self.session.run(None, feeds)
        except Exception as error:  # onnxruntime's errors have no common base class
            raise DvrkCmaesError(f"{self.file}: the model failed: {one_line(error)}") from None
        return {name: np.asarray(output) for name, output in zip(self.outputs, outputs, strict=True)}


def open_export(folder: Path, threads: int) -> tuple[OnnxModel, OnnxModel]:
    """Open the encoder and the decoder in a folder, or in ``onnx/`` below it, whatever the names of the files.

    Raises
    ------
    InputError
        onnxruntime is not installed, the folder does not exist, or it has no pair that can be used; the message says
        what each file is.
    """
    if importlib.util.find_spec("onnxruntime") is None:
        raise missing_library("model sam2", "onnxruntime")
    if not folder.is_dir():
        raise InputError(f"{folder}: expected the folder of an exported checkpoint, got {no_folder(folder)}")
    files = sorted(folder.glob("*.onnx")) or sorted(folder.glob("onnx/*.onnx"))
    models, got = [], []
    for file in files:
        try:
            model = _open(file, threads)
        except InputError as error:
            got.append(str(error).removeprefix(f"{folder}/"))
            continue
        models.append(model)
        got.append(f"{file.name} ({'encoder' if model.is_encoder else f'takes {listed(model.inputs)}'})")
    encoders = [each for each in models if each.is_encoder]
    known = {*_BY_POSITION, *_prompt((SIDE, SIDE), Hints())}.union(*(each.outputs for each in encoders))
    decoders = [each for each in models if not each.is_encoder and known.issuperset(each.inputs)]
    pairs = [(one, other) for one in encoders for other in decoders]
    if len(pairs) != 1:
        raise InputError(f"{folder}: {_EXPECTED}, got {', '.join(got) or 'no .onnx file'}")
    return pairs[0]


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


class Sam2:
    """An exported Segment Anything 2 or 2.1 model, loaded with onnxruntime.

    Parameters
    ----------
    weights
        Folder of the export's encoder and decoder.
    threads
        Number of threads, at least 1.

    Raises
    ------
    InputError
        No pair of files that can be used, or onnxruntime is not installed.
    """

    def __init__(self, weights: str | Path, threads: int = 2):
        if threads < 1:
            raise InputError(f"threads: expected a whole number of at least 1, got {threads}")
        self._encoder, self._decoder = open_export(Path(weights), threads)
        self._seen: tuple[bytes, Tensors] | None = None  # the last image's digest and features

    def segment(self, image: NDArray[np.uint8], hints: Hints) -> Segmentation:
        """Segment the object that all prompts together indicate.

        Parameters
        ----------
        image
            (H, W, 3) uint8, BGR. If it is the image of the last call, its features are not computed again.
        hints
            A box or a point on the instrument, and pixels that are not.

        Returns
        -------
        Segmentation
            ``confidence`` is the predicted IoU, or the predicted probability that there is an object at the prompt if
            the export gives it and it is less.

        Raises
        ------
        InputError
            No box and no point on the instrument, or prompts outside the image.
        DvrkCmaesError
            The model fails, or its outputs are not masks of finite values.
        """
        image = np.asarray(image)
        check_prompts(image, hints)
        if hints.box is None and not hints.points:
            raise InputError("prompt: Segment Anything 2 needs a box or a point on the instrument, got neither")
        shape = (image.shape[0], image.shape[1])
        outputs = self._decoder.run(self._features(image) | _prompt(shape, hints))
        overlaps = self._output(outputs, _OVERLAPS, 1).reshape(-1)
        masks = self._output(outputs, _MASKS, 0)
        if not overlaps.size or masks.ndim < 3 or masks.size != overlaps.size * masks.shape[-2] * masks.shape[-1]:
            got = " x ".join(str(length) for length in masks.shape)
            raise DvrkCmaesError(
                f"{self._decoder.file}: expected {overlaps.size} masks, as many as overlaps, got an array of {got}"
            )
        logits = resize_logits(masks.reshape(overlaps.size, *masks.shape[-2:])[int(overlaps.argmax())], shape)
        mask, confidence = logits > 0, float(np.clip(overlaps.max(), 0, 1))
        if not mask.any():
            return Segmentation(mask, 0.0, ("the model found nothing at the prompt",))
        notes: tuple[str, ...] = ()
        if _PRESENCE in outputs:
            presence = float(1 / (1 + np.exp(-np.clip(self._output(outputs, (_PRESENCE,), 0).reshape(-1)[0], -60, 60))))
            confidence = min(confidence, presence)
            if presence < 0.5:
                notes = (f"the model doubts that there is an object at the prompt (probability {presence:.2f})",)
        return Segmentation(mask, confidence, notes)

    def _features(self, image: NDArray[np.uint8]) -> Tensors:
        """Return the features of an image, from the last call if the image is the same."""
        digest = hashlib.blake2b(repr(image.shape).encode() + np.ascontiguousarray(image).tobytes()).digest()
        if self._seen is None or self._seen[0] != digest:
            outputs = self._encoder.run(dict.fromkeys(self._encoder.inputs, _encoder_input(image)))
            self._seen = digest, dict(zip(_BY_POSITION, outputs.values(), strict=False)) | outputs
        return self._seen[1]

    def _output(self, outputs: Tensors, names: Sequence[str], position: int) -> Float32:
        """Return the decoder's output that has one of the names, or is at a position; DvrkCmaesError if not finite."""
        named = [outputs[name] for name in names if name in outputs] or list(outputs.values())[position:]
        if not named or named[0].dtype == np.bool_ or not named[0].size or not np.isfinite(named[0]).all():
            problem = "the model returned values that are not finite; use an export in float32"
            raise DvrkCmaesError(f"{self._decoder.file}: {problem}")
        return named[0].astype(np.float32)


@lru_cache(maxsize=1)
def load_sam2(weights: Path, threads: int) -> Sam2:
    """Load an export, or return it from the cache if it was the last one loaded; loading takes seconds."""
    return Sam2(weights, threads)


def segment_sam2(
    image: NDArray[np.uint8], weights: Path, threads: int, hints: Hints, otherwise: Callable[[], Segmentation]
) -> Segmentation:
    """Segment the instrument as `Sam2.segment` does; without a box or a point, by those of the ``classic`` mask.

    Its point is the one farthest from its outline.

    Parameters and errors are as in `Sam2` and `Sam2.segment`, except that without a prompt InputError is raised only if
    ``otherwise``, which returns the ``classic`` mask, finds no instrument.
    """
    model = load_sam2(weights, threads)
    if hints.box is not None or hints.points:
        return model.segment(image, hints)
    guess = otherwise()
    if not guess.mask.any():
        raise InputError("prompt: Segment Anything 2 needs a box or a point; without one, classic found no instrument")
    left, top, width, height = window_around(guess.mask, margin=0)
    v, u = np.unravel_index(int(distance_to(~guess.mask).argmax()), guess.mask.shape)
    box = left, top, left + width - 1, top + height - 1
    segmentation = model.segment(image, Hints(box, [(float(u), float(v))], hints.not_points))
    note = f"no prompt: asked by box and point of the classic segmentation (confidence {guess.confidence:.2f})"
    confidence = min(segmentation.confidence, guess.confidence)
    return replace(segmentation, confidence=confidence, notes=(note, *segmentation.notes))


def _prompt(shape: tuple[int, int], hints: Hints) -> Tensors:
    """Return prompts as the inputs of all decoders; a box is clipped to the border of an image of a shape (H, W)."""
    height, width = shape
    to_square = SIDE / width, SIDE / height
    pixels = np.array([*hints.points, *hints.not_points], np.float64).reshape(-1, 2) * to_square
    labels = np.array([_ON] * len(hints.points) + [_OFF] * len(hints.not_points), np.int64)
    corners = np.array([] if hints.box is None else hints.box).reshape(-1, 2)
    corners = np.clip(corners, 0, (width, height)) * to_square
    of_corners = [_BOX_START, _BOX_END][: len(corners)]
    no_mask, has_no_mask = np.zeros((1, 1, SIDE // 4, SIDE // 4), np.float32), np.zeros(1, np.float32)
    return {
        "point_coords": np.concatenate([corners, pixels])[None],
        "point_labels": np.concatenate([np.array(of_corners, np.int64), labels])[None],
        "input_points": pixels[None, None],
        "input_labels": labels[None, None],
        "input_boxes": corners.reshape(1, -1, 4),
        **dict.fromkeys(("mask_input", "input_masks"), no_mask),
        **dict.fromkeys(("has_mask_input", "has_input_masks"), has_no_mask),
        **dict.fromkeys(("orig_im_size", "original_image_size"), np.array(shape)),
    }


def _encoder_input(image: NDArray[np.uint8]) -> Float32:
    """Convert an image (H, W, 3) uint8 BGR to the encoder's input (1, 3, 1024, 1024), RGB and normalised.

    A side longer than 1024 is reduced by area averaging, to avoid aliasing; a shorter one is interpolated bilinearly.
    """
    height, width = image.shape[:2]
    rgb = image[:, :, ::-1].astype(np.float32) / np.float32(255)
    small = cv2.resize(rgb, (min(width, SIDE), min(height, SIDE)), interpolation=cv2.INTER_AREA)
    square = cv2.resize(small, (SIDE, SIDE), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(((square - _MEAN) / _DEVIATION).transpose(2, 0, 1)[None], np.float32)


def resize_logits(logits: Float32, shape: tuple[int, int]) -> Float32:
    """Interpolate mask logits (h, w) bilinearly to an image's height and width."""
    return np.asarray(cv2.resize(logits, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
