"""Families of Segment Anything 2 exports, identified by the names of their tensors.

An export consists of two files: an encoder, run once an image, and a decoder, run once a prompt. Exporters differ in
the names and the order of the tensors; a `Family` describes those of one exporter. All four families take prompts in
pixels of the encoder's square of 1024 pixels, x before y:

- samexporter: `samexporter/export_sam2.py` and `sam2_onnx.py` (coordinates are divided by the image's size and
  multiplied by the encoder's; the graph appends the padding point). Older versions also take ``orig_im_size``, later
  ones also return ``low_res_masks``.
- onnxruntime: `onnxruntime/python/tools/transformers/models/sam2/image_decoder.py` ("normalized with H=W=1024"; the
  graph appends the padding point, and returns boolean masks of the image's size and logits).
- onnx-community: `Sam2Model.forward` in transformers.js (a box in ``input_boxes``; where there is no point, or no box,
  an empty tensor; the processor scales both to the square).
- osam: `osam/_models/sam2` (the encoder's outputs are identified by position; the graph scales masks to the image).

Source of the numbers: these, and `SAM2ImagePredictor` in facebookresearch/sam2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Float32
from dvrk_cmaes.segment.sam2_images import SIDE

Tensors = dict[str, NDArray[Any]]
Role = Literal["masks", "overlaps", "logits", "presence"]

ON, OFF, BOX_START, BOX_END = 1, 0, 2, 3  # labels of points; -1 is padding, which the graphs append
_MASK_SIDE = SIDE // 4  # of a mask given as a prompt, px


@dataclass(frozen=True, eq=False)
class Prompt:
    """Prompts in pixels of the encoder's square.

    points : (N, 2) float32, x and y.
    labels : (N,) int64, 1 on the instrument, 0 off it.
    box : (4,) float32, left, top, right, bottom, or None.
    shape : height and width of the original image, px.
    """

    points: Float32
    labels: NDArray[np.int64]
    box: Float32 | None
    shape: tuple[int, int]

    def with_corners(self) -> tuple[Float32, NDArray[np.int64]]:
        """Return points (1, M, 2) and labels (1, M); the box's corners are included as points with labels 2 and 3."""
        if self.box is None:
            return self.points[None], self.labels[None]
        points = np.concatenate([self.box.reshape(2, 2), self.points])
        return points[None], np.concatenate([[BOX_START, BOX_END], self.labels])[None]


@dataclass(frozen=True)
class Family:
    """Names of the inputs and outputs in the files of one exporter.

    name : name of the exporter.
    image : the encoder's input.
    encoded : the encoder's outputs, by name or, where names differ between files, by position.
    features : the decoder's inputs for these outputs, in the same order.
    prompt_inputs : function that makes the decoder's other inputs from a prompt.
    outputs : the decoder's outputs, by name or position, keyed by role: ``masks`` (logits, or boolean masks),
        ``overlaps`` (predicted IoU of each mask), ``logits`` (if ``masks`` are boolean), ``presence`` (logit of whether
        there is an object at the prompt).
    optional : inputs of the decoder that only some files have.
    """

    name: str
    image: str
    encoded: tuple[str | int, ...]
    features: tuple[str, ...]
    prompt_inputs: Callable[[Prompt], Tensors]
    outputs: Mapping[Role, str | int]
    optional: frozenset[str] = frozenset()

    @property
    def decoder_inputs(self) -> frozenset[str]:
        """Names of all inputs of a decoder, including the optional ones."""
        nowhere = Prompt(np.zeros((0, 2), np.float32), np.zeros(0, np.int64), None, (SIDE, SIDE))
        return frozenset(self.features) | frozenset(self.prompt_inputs(nowhere))


def _no_mask(mask: str, has_mask: str) -> Tensors:
    """Return the two inputs that state that no mask is given as a prompt."""
    return {mask: np.zeros((1, 1, _MASK_SIDE, _MASK_SIDE), np.float32), has_mask: np.zeros(1, np.float32)}


def _points(prompt: Prompt) -> Tensors:
    points, labels = prompt.with_corners()
    return {"point_coords": points, "point_labels": labels}


def _samexporter(prompt: Prompt) -> Tensors:
    return _points(prompt) | _no_mask("mask_input", "has_mask_input") | {"orig_im_size": np.array(prompt.shape)}


def _onnxruntime(prompt: Prompt) -> Tensors:
    size = {"original_image_size": np.array(prompt.shape)}
    return _points(prompt) | _no_mask("input_masks", "has_input_masks") | size


def _onnx_community(prompt: Prompt) -> Tensors:
    boxes = np.zeros((0, 4), np.float32) if prompt.box is None else prompt.box[None]
    return {
        "input_points": prompt.points[None, None],
        "input_labels": prompt.labels[None, None],
        "input_boxes": boxes[None],
    }


FAMILIES = (
    Family(
        name="samexporter",
        image="image",
        encoded=("high_res_feats_0", "high_res_feats_1", "image_embed"),
        features=("high_res_feats_0", "high_res_feats_1", "image_embed"),
        prompt_inputs=_samexporter,
        optional=frozenset({"orig_im_size"}),
        outputs={"masks": "masks", "overlaps": "iou_predictions"},
    ),
    Family(
        name="onnxruntime",
        image="image",
        encoded=("image_features_0", "image_features_1", "image_embeddings"),
        features=("image_features_0", "image_features_1", "image_embeddings"),
        prompt_inputs=_onnxruntime,
        outputs={"masks": "masks", "overlaps": "iou_predictions", "logits": "low_res_masks"},
    ),
    Family(
        name="onnx-community",
        image="pixel_values",
        encoded=("image_embeddings.0", "image_embeddings.1", "image_embeddings.2"),
        features=("image_embeddings.0", "image_embeddings.1", "image_embeddings.2"),
        prompt_inputs=_onnx_community,
        outputs={"masks": "pred_masks", "overlaps": "iou_scores", "presence": "object_score_logits"},
    ),
    Family(
        name="osam",
        image="input",
        encoded=(0, 1, 2),
        features=("image_embeddings", "high_res_features1", "high_res_features2"),
        prompt_inputs=_samexporter,
        outputs={"masks": 0, "overlaps": 1},
    ),
)
