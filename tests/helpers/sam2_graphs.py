"""Small ONNX models with the tensors of Segment Anything 2 exports and known output.

The encoder averages the normalised image over cells of 4, 8 and 16 pixels, and gives the averages as features; the
decoder undoes the normalisation and finds the pixels of the colour `TOOL` near a point on the instrument (up to `REACH`
in the square of 1024 pixels) or in the box, without those near a point beside it. The output is right only if colour
order, normalisation, resizing, coordinates and labels are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnx.parser
from onnx import numpy_helper

TOOL = (200, 60, 30)
"""Colour of the instrument, RGB; BGR values, or values off by 0.03 of 1 in any channel, are background."""

REACH = 240.0
ALL_IOUS = (0.31, 0.93, 0.52)  # predicted overlaps of the full, the right and the empty mask

FAMILIES = ("samexporter", "onnxruntime", "onnx-community", "osam")

_FEATURES = {  # by family: the encoder's input, its outputs by size, and the decoder's inputs for them
    "samexporter": ("image", ("high_res_feats_0", "high_res_feats_1", "image_embed"), None),
    "onnxruntime": ("image", ("image_features_0", "image_features_1", "image_embeddings"), None),
    "onnx-community": ("pixel_values", tuple(f"image_embeddings.{k}" for k in range(3)), None),
    "osam": ("input", ("f0", "f1", "e"), ("high_res_features1", "high_res_features2", "image_embeddings")),
}
_SHAPES = ([1, 32, 256, 256], [1, 64, 128, 128], [1, 256, 64, 64])
_ORDER = {"osam": (2, 0, 1)}  # order of the encoder's outputs

_PROMPTS = {  # the decoder's other inputs, and their conversion to points [N, 2] and labels [N]
    "samexporter": (
        "float[L, N, 2] point_coords, float[L, N] point_labels, float[L, 1, 256, 256] mask_input, "
        "float[L] has_mask_input",
        "points = Squeeze(point_coords, first) labels = Squeeze(point_labels, first)",
    ),
    "onnxruntime": (
        "float[L, N, 2] point_coords, int32[L, N] point_labels, float[L, 1, 256, 256] input_masks, "
        "float[L] has_input_masks, int32[2] original_image_size",
        "points = Squeeze(point_coords, first) whole = Squeeze(point_labels, first) labels = Cast<to = 1>(whole)",
    ),
    "onnx-community": (
        "float[B, 1, N, 2] input_points, int64[B, 1, N] input_labels, float[B, M, 4] input_boxes",
        "some = Squeeze(input_points, both) whole = Squeeze(input_labels, both) given = Cast<to = 1>(whole) "
        "boxes = Squeeze(input_boxes, first) starts = Slice(boxes, zero, two, one) ends = Slice(boxes, two, four, one) "
        "count = Shape<end = 1>(boxes) twos = Expand(start_label, count) threes = Expand(end_label, count) "
        "points = Concat<axis = 0>(some, starts, ends) labels = Concat<axis = 0>(given, twos, threes)",
    ),
    "osam": (
        "float[L, N, 2] point_coords, float[L, N] point_labels, float[1, 1, 256, 256] mask_input, "
        "float[1] has_mask_input, int64[2] orig_im_size",
        "points = Squeeze(point_coords, first) labels = Squeeze(point_labels, first)",
    ),
}
_TO_IMAGE = "whole_size = Cast<to = 7>({size}) sizes = Concat<axis = 0>(kept, whole_size) "
_TO_IMAGE += 'large = Resize<mode = "linear">(low, , , sizes) '
_ANSWERS = {  # the outputs, from the logits `low` [1, K, 256, 256] and `ious` [1, K]
    "samexporter": (
        "float[1, K, 256, 256] masks, float[1, K] iou_predictions",
        "masks = Identity(low) iou_predictions = Identity(ious)",
    ),
    "onnxruntime": (
        "bool[L, K, H, W] masks, float[L, K] iou_predictions, float[L, K, 256, 256] low_res_masks",
        _TO_IMAGE.format(size="original_image_size") + "masks = Greater(large, nought) "
        "iou_predictions = Identity(ious) low_res_masks = Identity(low)",
    ),
    "onnx-community": (
        "float[B, 1, K] iou_scores, float[B, 1, K, 256, 256] pred_masks, float[B, 1, 1] object_score_logits",
        "iou_scores = Unsqueeze(ious, one) pred_masks = Unsqueeze(low, one) object_score_logits = Identity(presence)",
    ),
    "osam": (
        "float[1, K, H, W] m, float[1, K] s, float[1, K, 256, 256] l",
        _TO_IMAGE.format(size="orig_im_size") + "m = Identity(large) s = Identity(ious) l = Identity(low)",
    ),
}
_BODY = """
    cells = Slice(finest, zero, three, one)
    spread = Mul(cells, deviation) colour = Add(spread, mean) off = Sub(colour, tool) far = Abs(off)
    worst = ReduceMax<axes = [1], keepdims = 0>(far) close = Sub(tolerance, worst) likeness = Mul(close, scale)
    all_points = Concat<axis = 0>(points, no_point) all_labels = Concat<axis = 0>(labels, no_label)
    x_flat = Slice(all_points, zero, one, one) y_flat = Slice(all_points, one, two, one)
    px = Unsqueeze(x_flat, one) py = Unsqueeze(y_flat, one)
    label_row = Unsqueeze(all_labels, one) label = Unsqueeze(label_row, one)
    dx = Sub(grid_x, px) dy = Sub(grid_y, py) dx2 = Mul(dx, dx) dy2 = Mul(dy, dy) d2 = Add(dx2, dy2)
    distance = Sqrt(d2) within = Sub(reach, distance) beyond = Neg(within)
    is_on = Equal(label, on) near_each = Where(is_on, within, low_value) near = ReduceMax<axes = [0]>(near_each)
    is_off = Equal(label, nought) clear_each = Where(is_off, beyond, high_value)
    clear = ReduceMin<axes = [0]>(clear_each)
    is_start = Equal(label, start_label) is_end = Equal(label, end_label)
    x0_each = Where(is_start, px, low_value) x0 = ReduceMax<axes = [0]>(x0_each)
    y0_each = Where(is_start, py, low_value) y0 = ReduceMax<axes = [0]>(y0_each)
    x1_each = Where(is_end, px, low_value) x1 = ReduceMax<axes = [0]>(x1_each)
    y1_each = Where(is_end, py, low_value) y1 = ReduceMax<axes = [0]>(y1_each)
    left = Sub(grid_x, x0) right = Sub(x1, grid_x) above = Sub(grid_y, y0) below = Sub(y1, grid_y)
    inside = Min(left, right, above, below)
    place = Max(near, inside) answer = Min(place, clear, likeness)
    right_mask = Unsqueeze(answer, one) everything = Add(zeros, on) nothing = Sub(zeros, on)
    three_masks = Concat<axis = 1>(everything, right_mask, nothing)
    low = Gather<axis = 1>(three_masks, chosen)
"""


def _constants(ious: tuple[float, ...], chosen: tuple[int, ...], presence: float) -> dict[str, np.ndarray]:
    centres = (np.arange(256, dtype=np.float32) + 0.5) * 4 - 0.5
    per_channel = {
        "mean": [0.485, 0.456, 0.406],
        "deviation": [0.229, 0.224, 0.225],
        "tool": np.array(TOOL) / 255,
    }
    integers = {"zero": [0], "one": [1], "two": [2], "three": [3], "four": [4], "first": [0], "both": [0, 1]}
    floats = {"on": 1, "nought": 0, "start_label": 2, "end_label": 3, "low_value": -1e4, "high_value": 1e4}
    floats |= {"reach": REACH, "tolerance": 0.03, "scale": 1000}
    return (
        {name: np.array(value, np.float32).reshape(1, 3, 1, 1) for name, value in per_channel.items()}
        | {name: np.array(value, np.int64) for name, value in integers.items()}
        | {name: np.array([value], np.float32) for name, value in floats.items()}
        | {
            "grid_x": centres.reshape(1, 1, 256),
            "grid_y": centres.reshape(1, 256, 1),
            "no_point": np.full((1, 2), -1e4, np.float32),
            "no_label": np.array([-1], np.float32),
            "zeros": np.zeros((1, 1, 256, 256), np.float32),
            "kept": np.array([1, len(chosen)], np.int64),
            "chosen": np.array(chosen, np.int64),
            "ious": np.array([ious], np.float32),
            "presence": np.full((1, 1, 1), presence, np.float32),
        }
    )


def _model(text: str, constants: dict[str, np.ndarray], names: dict[str, str]) -> onnx.ModelProto:
    """Parse a graph, add its constants, and rename tensors to names that the parser does not accept."""
    model = onnx.parser.parse_model(f'<ir_version: 8, opset_import: ["" : 17]> {text}')
    used = {name for node in model.graph.node for name in node.input}
    for name in sorted(used & set(constants)):
        model.graph.initializer.append(numpy_helper.from_array(constants[name], name))
    for values in (model.graph.input, model.graph.output):
        for value in values:
            value.name = names.get(value.name, value.name)
    for node in model.graph.node:
        node.input[:] = [names.get(name, name) for name in node.input]
        node.output[:] = [names.get(name, name) for name in node.output]
    onnx.checker.check_model(model)
    return model


def encoder(family: str, *, side: int = 1024) -> onnx.ModelProto:
    """Make a family's encoder."""
    image, outputs, _ = _FEATURES[family]
    order = _ORDER.get(family, (0, 1, 2))
    body, constants = [], {}
    for k, (_, channels, _, _) in enumerate(_SHAPES):
        cell = 4 << k
        body.append(f"mean{k} = AveragePool<kernel_shape = [{cell}, {cell}], strides = [{cell}, {cell}]>({image})")
        body.append(f"out{k} = Conv(mean{k}, pick{k})")
        constants[f"pick{k}"] = np.eye(channels, 3, dtype=np.float32).reshape(channels, 3, 1, 1)
    shapes = ["1, {}, {}, {}".format(*_SHAPES[k][1:]) for k in range(3)]
    declared = ", ".join(f"float[{shapes[k]}] out{k}" for k in order)
    text = f"encoder (float[1, 3, {side}, {side}] {image}) => ({declared}) {{ {' '.join(body)} }}"
    return _model(text, constants, {f"out{k}": outputs[k] for k in range(3)})


def decoder(
    family: str,
    *,
    ious: tuple[float, ...] = ALL_IOUS,
    chosen: tuple[int, ...] = (0, 1, 2),
    presence: float = 5.0,
) -> onnx.ModelProto:
    """Make a family's decoder: ``chosen`` of the masks (all, right, none) with the overlaps ``ious``."""
    _, outputs, renamed = _FEATURES[family]
    features = renamed or outputs
    inputs, points = _PROMPTS[family]
    answers, ending = _ANSWERS[family]
    shapes = ["1, {}, {}, {}".format(*shape[1:]) for shape in _SHAPES]
    taken = ", ".join(f"float[{shapes[k]}] feature{k}" for k in _ORDER.get(family, (0, 1, 2)))
    body = _BODY.replace("finest", "feature0")
    text = f"decoder ({taken}, {inputs}) => ({answers}) {{ {points} {body} {ending} }}"
    return _model(text, _constants(ious, chosen, presence), {f"feature{k}": features[k] for k in range(3)})


def write_export(
    folder: Path, family: str, *, names: tuple[str, str] = ("first.onnx", "second.onnx"), **options: object
) -> Path:
    """Write a family's encoder and decoder under any names; ``options`` as of `decoder`."""
    folder.mkdir(parents=True, exist_ok=True)
    onnx.save(encoder(family), folder / names[0])
    onnx.save(decoder(family, **options), folder / names[1])  # type: ignore[arg-type]
    return folder
