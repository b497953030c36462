"""Conversion of images, prompts and mask logits between an image and the encoder's square of Segment Anything 2.

Every image is resized to a square of 1024 pixels, whatever its aspect ratio. Prompts are scaled in the same way, to
u 1024 / width and v 1024 / height, as in the model's own predictor; every export adds half a pixel itself before it
normalises them. Mask logits are interpolated to the image's size before they are thresholded: thresholding first would
leave the steps of a 256-pixel mask in the outline.

Source of the numbers: `SAM2Transforms` and `SAM2ImagePredictor` in facebookresearch/sam2.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Float32, Float64

SIDE = 1024  # px, side of the encoder's square

_MEAN = np.array([0.485, 0.456, 0.406], np.float32)  # mean of ImageNet, RGB, for values from 0 to 1
_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)


def encoder_input(image: NDArray[np.uint8]) -> Float32:
    """Convert an image (H, W, 3) uint8 BGR to the encoder's input (1, 3, 1024, 1024), RGB and normalised.

    A side longer than 1024 is reduced by area averaging, to avoid aliasing; a shorter one is interpolated bilinearly.
    """
    height, width = image.shape[:2]
    rgb = image[:, :, ::-1].astype(np.float32) / np.float32(255)
    small = cv2.resize(rgb, (min(width, SIDE), min(height, SIDE)), interpolation=cv2.INTER_AREA)
    square = cv2.resize(small, (SIDE, SIDE), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(((square - _MEAN) / _DEVIATION).transpose(2, 0, 1)[None], np.float32)


def to_square(pixels: Float64, shape: tuple[int, int]) -> Float32:
    """Scale pixels (N, 2) of an image of this height and width to the encoder's square."""
    height, width = shape
    return np.asarray(pixels * (SIDE / width, SIDE / height), np.float32)


def resize_logits(logits: Float32, shape: tuple[int, int]) -> Float32:
    """Interpolate mask logits (h, w) bilinearly to an image's height and width."""
    height, width = shape
    if logits.shape == (height, width):
        return logits
    return np.asarray(cv2.resize(logits, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def probability(logits: Float32) -> Float32:
    """Turn logits of any shape into probabilities by the logistic function."""
    return np.asarray(1 / (1 + np.exp(-np.clip(logits, -60, 60))), np.float32)
