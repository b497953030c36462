"""Stretches of a mask's contour that are no edge in the image: a shadow was taken for the instrument.

Across the contour of an instrument the image changes at the contour. Where it hardly does, but does so clearly farther
inside the mask, what lies between is not the instrument.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.outline_noise import sampled
from dvrk_cmaes.geometry import Bool, Float32, Float64

# px of an image 640 px wide
_DEEP, _AROUND, _INSIDE = 12.0, 2.0, 3.0  # how far inside, how far from the contour, and from where on inside
_ALONG = 31.0  # of contour, over which changes are averaged
_DEEPER = 1.5  # times as deep, where a mask that is no narrow jaw has its contour on the same side still
_BLUR = 1.0
_STEP = 2  # px of the image along the contour, between its points
_WEAK, _LEAST = 0.35, 8.0  # share of the change inside, and grey levels a pixel inside
_BORDER = 3  # px of the image, at its border, where contours end


def shadow_stretches(image: NDArray[np.uint8], mask: Bool) -> Bool | None:
    """Return the pixels (H, W) about stretches of a mask's contour that are no edge of the image; None without any.

    Parameters
    ----------
    image : (H', W', 3)
        The image, BGR, of the mask's aspect.
    mask : (H, W)
        The mask.
    """
    height, width = mask.shape
    size = max(width / 640, 0.5)
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.float32)
    if grey.shape != mask.shape:
        grey = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)
    grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), _BLUR * size), dtype=np.float32)
    outward = _outward(mask, 2 * size)
    within = np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5), dtype=np.float32)
    out = np.zeros(mask.shape, dtype=np.uint8)
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    window = 2 * round(_ALONG * size / _STEP / 2) + 1
    offsets = np.arange(-_DEEP * size, _AROUND * size + 0.5)
    for contour in contours:
        points = contour[::_STEP, 0].astype(np.float64)
        if len(points) < 2 * window:
            continue
        pixels = points.astype(int)
        normals = outward[pixels[:, 1], pixels[:, 0]]
        changes = np.abs(_averaged(_across(grey, points, normals, offsets), window))
        inner = offsets <= -_INSIDE * size
        inside, there = changes[:, inner].max(axis=1), changes[:, ~inner & (np.abs(offsets) <= _AROUND * size)]
        shadow = (inside > _LEAST / size) & (there.max(axis=1) < _WEAK * inside)
        shadow &= ((pixels >= _BORDER) & (pixels < np.array([width, height]) - _BORDER)).all(axis=1)
        depth = -offsets[inner][changes[:, inner].argmax(axis=1)]
        ends = points - normals * (depth + _AROUND * size)[:, None]
        shadow &= sampled(within, points - normals * (_DEEPER * depth)[:, None]) > depth
        begins = points + normals * _AROUND * size
        for i, k in pairwise(np.flatnonzero(shadow).tolist()):
            if k == i + 1:
                corners = np.array([begins[i], begins[k], ends[k], ends[i]]).round().astype(np.int32)
                cv2.fillConvexPoly(out, corners, 1)
    return out > 0 if out.any() else None


def _outward(mask: Bool, blur: float) -> Float32:
    """Return unit vectors (H, W, 2) that point out of a mask, of its blurred edge."""
    blurred = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), blur)
    slope = -np.stack([cv2.Sobel(blurred, cv2.CV_32F, *axis) for axis in ((1, 0), (0, 1))], axis=-1)
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-9), dtype=np.float32)


def _across(grey: Float32, points: Float64, normals: Float32, offsets: Float64) -> Float64:
    """Return the changes (P, O) of an image, grey levels a pixel, across a contour at some distances outwards."""
    sides = [points[:, None] + normals[:, None] * (offsets + aside)[:, None] for aside in (0.5, -0.5)]
    ahead, behind = (sampled(grey, side.reshape(-1, 2)).reshape(side.shape[:2]) for side in sides)
    return ahead - behind


def _averaged(values: Float64, window: int) -> Float64:
    """Return the running means of values (P, O) along a closed contour."""
    half = window // 2
    around = np.concatenate([values[-half:], values, values[:half]])
    return np.asarray(cv2.blur(around, (1, window))[half : half + len(values)], dtype=np.float64)
